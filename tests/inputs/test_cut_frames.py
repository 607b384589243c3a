"""Frames that are shorter than their message in the database: what lies in them is taken."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from engine_bus import columns_of, load
from imucald.inputs.wiring import compile_router

DBC = """VERSION ""
BU_: CAR
BO_ 256 IMU: 8 CAR
 SG_ AX : 0|16@1- (0.001,0) [-30|30] "m/s^2" CAR
 SG_ AY : 16|16@1- (0.001,0) [-30|30] "m/s^2" CAR
 SG_ AZ : 32|16@1- (0.001,0) [-30|30] "m/s^2" CAR
 SG_ T : 55|16@0- (1,0) [0|0] "degC" CAR
"""
TEXT = """database: bus.dbc
signals:
  accelerometer: {x: IMU.AX, y: IMU.AY, z: IMU.AZ}
  temperature: IMU.T
"""
CHECKSUM = "messages: {IMU: {checksum: {kind: xor, signal: T}}}\n"


@settings(max_examples=60, deadline=None)
@given(st.lists(st.binary(max_size=9), min_size=1, max_size=8))
def test_what_lies_in_a_cut_frame_is_taken_alike_both_ways(tmp_path_factory, payloads):
    loaded = load(TEXT, tmp_path_factory.mktemp("cut"), DBC)
    live, replayed = compile_router(loaded), compile_router(loaded)
    frames = [(0.1 * i, 256, data) for i, data in enumerate(payloads)]
    found: dict[str, list[list[float]]] = {}
    for t, can_id, data in frames:
        samples, refused, _ = live.frame(t, can_id, data)
        assert ("accel" in refused) == (len(data) < 6) or live.rejected
        assert len(data) >= 8 or "temperature" not in dict(samples)
        for channel, values in samples:
            found.setdefault(channel, []).append(list(values))
    columns = columns_of(frames)
    routed = replayed.columns(columns.t, columns)
    assert {c: s.values.reshape(len(s.t), -1).tolist() for c, s in routed.samples.items()} == found
    assert live.rejected == replayed.rejected
    assert live.rejected["short_frame"] == sum(len(data) < 6 for data in payloads)


@pytest.mark.parametrize(("length", "taken"), [(6, True), (7, True), (8, True), (5, False)])
def test_axes_within_the_frame_are_taken(tmp_path, length, taken):
    router = compile_router(load(TEXT, tmp_path, DBC))
    samples, _, _ = router.frame(0.0, 256, (b"\xe8\x03" * 4)[:length])
    assert ("accel" in dict(samples)) == taken


def test_a_frame_whose_checksum_is_beyond_it_is_short(tmp_path):
    text = TEXT.replace("  temperature: IMU.T\n", "") + CHECKSUM
    text = text.replace("signal: T", "signal: C")
    dbc = DBC.replace("SG_ T : 55|16@0-", "SG_ C : 56|8@1+")
    router = compile_router(load(text, tmp_path, dbc))
    assert router.frame(0.0, 256, bytes(7)) == ([], ["accel"], [])
    assert router.rejected == {"short_frame": 1}
