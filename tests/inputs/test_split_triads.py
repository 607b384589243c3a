"""Triads whose axes come in several frames: of one multiplexed message, or of several messages."""

from __future__ import annotations

import pytest

from engine_bus import columns_of, load
from imucald.core.errors import ConfigError
from imucald.inputs.wiring import compile_router

DBC = """VERSION ""
BU_: CAR
BO_ 256 IMU: 3 CAR
 SG_ Axis M : 0|8@1+ (1,0) [0|0] "" CAR
 SG_ AX m1 : 8|16@1- (1,0) [0|0] "m/s^2" CAR
 SG_ AY m2 : 8|16@1- (1,0) [0|0] "m/s^2" CAR
 SG_ AZ m3 : 8|16@1- (1,0) [0|0] "m/s^2" CAR
BO_ 257 XY: 2 CAR
 SG_ BX : 0|8@1- (1,0) [0|0] "m/s^2" CAR
 SG_ BY : 8|8@1- (1,0) [0|0] "m/s^2" CAR
BO_ 258 Z: 1 CAR
 SG_ BZ : 0|8@1- (1,0) [0|0] "m/s^2" CAR
"""
ONE_AXIS = "database: bus.dbc\nsignals: {accelerometer: {x: IMU.AX, y: IMU.AY, z: IMU.AZ}}\n"
TWO_MESSAGES = "database: bus.dbc\nsignals: {accelerometer: {x: XY.BX, y: XY.BY, z: Z.BZ}}\n"

Frames = list[tuple[float, int, bytes]]


def both_ways(text: str, folder, frames: Frames) -> list[tuple[float, list[float]]]:
    """Samples of the accelerometer with their times, live, and the same in columns."""
    loaded = load(text, folder, DBC)
    live, replayed = compile_router(loaded), compile_router(loaded)
    one = [
        (t, list(values))
        for t, can_id, data in frames
        for _, values in live.frame(t, can_id, data)[0]
    ]
    again = []
    for part in (frames[: len(frames) // 2], frames[len(frames) // 2 :]):
        columns = columns_of(part)
        samples = replayed.columns(columns.t, columns).samples.get("accel")
        if samples is not None:
            again += list(zip(samples.t.tolist(), samples.values.tolist(), strict=True))
    assert one == again
    return one


def axes(count: int) -> Frames:
    """One axis a frame; the value is 10 times the cycle and the axis."""
    return [
        (round(0.01 * k + 0.003 * i, 4), 256, bytes([i, 10 * k + i, 0]))
        for k in range(count)
        for i in (1, 2, 3)
    ]


def test_one_axis_a_frame_gives_a_sample_a_cycle(tmp_path):
    found = both_ways(ONE_AXIS, tmp_path, axes(4))
    assert [v for _, v in found] == [[10 * k + 1, 10 * k + 2, 10 * k + 3] for k in range(4)]


@pytest.mark.parametrize("lost", [12, 13, 14])
def test_a_lost_axis_costs_one_sample_and_none_is_of_other_times(tmp_path, lost):
    frames = axes(10)
    del frames[lost]
    found = [v for _, v in both_ways(ONE_AXIS, tmp_path, frames)]
    assert len(found) == 9
    assert all(max(values) - min(values) <= 10 for values in found), "no older than a cycle"


def test_axes_of_two_messages_of_other_rates_are_put_together_by_their_times(tmp_path):
    xy = [(0.01 * k, 257, bytes([k, k])) for k in range(20)]
    z = [(0.02 * k + 0.001, 258, bytes([k])) for k in range(10)]
    found = both_ways(TWO_MESSAGES, tmp_path, sorted(xy + z))
    assert [v for _, v in found] == [[2 * k, 2 * k, k] for k in range(10)]


def test_two_axes_of_a_level_sensor_come_in_one_frame(tmp_path):
    text = "database: bus.dbc\nsignals: {accelerometer: {x: IMU.AX, y: IMU.AY}}\n"
    with pytest.raises(ConfigError, match="one frame"):
        compile_router(load(text, tmp_path, DBC))
