"""Hostile nodes against a running service: refused, counted, DTCs set, memory bounded."""

from __future__ import annotations

import gc
import struct
import threading
import time
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from simulated_bus import drive_frames
from uds_bus import REQUEST, RESPONSE, UdsBench, asking, guarded_config, with_diagnostics

pytestmark = pytest.mark.slow

CHECKSUM, COUNTER, CONFLICT = 0xDA1083, 0xDA1082, 0xDA1181
CONFIRMED = 0x08


def codes(bench: UdsBench) -> set[int]:
    """Confirmed DTCs, as a tester reads them."""
    with asking(bench.tester_bus) as client:
        response = client.get_dtc_by_status_mask(CONFIRMED)
        return {d.id for d in response.service_data.dtcs}


def guarded_bench(folder: Path) -> UdsBench:
    """On the simulated bus, whose IMU frames have counters and checksums."""
    config = guarded_config(folder)
    columns = drive_frames().take(slice(0, 6000))
    frames = [
        (t, i, data[:n].tobytes())
        for t, i, n, data in zip(
            columns.t.tolist(),
            columns.can_id.tolist(),
            columns.length.tolist(),
            columns.data,
            strict=True,
        )
    ]
    return UdsBench(folder, config, frames)


@pytest.fixture
def guarded(tmp_path) -> Iterator[UdsBench]:
    with guarded_bench(tmp_path) as made:
        yield made


@pytest.fixture
def bench(tmp_path) -> Iterator[UdsBench]:
    with UdsBench(tmp_path, with_diagnostics(tmp_path)) as made:
        yield made


def imu_frames(bench: UdsBench, count: int) -> list[tuple[float, int, bytes]]:
    """Frames of the message with the accelerometer that were played last."""
    (match,) = {
        r.match.can_id
        for r in bench.service.engine.router.routes
        if any(t.channel == "accel" for t in r.taps)
    }
    played = [f for f in bench.frames[: bench._played] if f[1] == match]
    return played[-count:]


def settled(bench: UdsBench) -> None:
    """All that was sent has been handled, and the DTCs judged."""
    time.sleep(0.5)


def test_recorded_frames_played_again_are_refused_and_reported(guarded):
    guarded.play(2.0)
    settled(guarded)
    assert not codes(guarded) & {CHECKSUM, COUNTER, CONFLICT}
    router = guarded.service.engine.router
    before, estimate = router.sample_counts["accel"], guarded.service.engine.pipeline.correction
    newest = imu_frames(guarded, 1)[0]
    for _, can_id, data in [newest] * 20:  # the same frame again and again: its counter stands
        guarded.send(can_id, data, newest[0])
    for _, can_id, data in imu_frames(guarded, 4)[:3]:  # a little older: its counter goes back
        guarded.send(can_id, data, newest[0])
    settled(guarded)
    taken = router.sample_counts["accel"] - before
    assert taken <= 1, "only the first: the counter may have gone round in the silence before it"
    assert guarded.service.engine.pipeline.correction == estimate
    assert router.rejected["counter_repeated"] >= 19
    assert COUNTER in codes(guarded)
    assert CHECKSUM not in codes(guarded)


def test_a_recording_played_beside_the_real_sensor_is_not_learnt_from(guarded):
    """Old and new frames by turns: each is a jump for the other, and neither is taken in."""
    guarded.play(2.0)
    settled(guarded)
    router = guarded.service.engine.router
    old = imu_frames(guarded, 100)
    before = router.sample_counts["accel"]
    for _, can_id, data in old:
        guarded.play(guarded.frames[guarded._played][0] - guarded.start + 0.0101)
        guarded.send(can_id, data, guarded.frames[guarded._played - 1][0])
    settled(guarded)
    assert router.sample_counts["accel"] - before < 10
    assert router.rejected["counter_jump"] + router.rejected["counter_reversed"] > 50
    assert COUNTER in codes(guarded)


def test_forged_values_without_the_right_checksum_are_refused_and_reported(guarded):
    guarded.play(2.0)
    settled(guarded)
    router = guarded.service.engine.router
    before = router.sample_counts["accel"]
    t, can_id, data = imu_frames(guarded, 1)[0]
    for value in range(20):
        forged = struct.pack("<h", 400 * value) + data[2:]
        if forged != data:
            guarded.send(can_id, forged, t)
    settled(guarded)
    assert router.sample_counts["accel"] == before
    assert router.rejected["checksum"] >= 19
    assert CHECKSUM in codes(guarded)
    guarded.play(3.0)
    assert router.sample_counts["accel"] > before, "the real ones are heard again"


@pytest.mark.parametrize("spoofed", [0x640, 0x643, 0x645, RESPONSE])
def test_a_node_that_sends_our_identifiers_is_reported_and_not_heard(bench, spoofed):
    bench.play(1.0)
    settled(bench)
    used = bench.service.engine.router.used
    assert CONFLICT not in codes(bench)
    for _ in range(5):
        bench.send(spoofed, bytes(8))
    settled(bench)
    assert bench.service.link.counters.conflicts == 5
    assert bench.service.engine.router.used == used
    assert bench.service.engine.health().id_conflict
    assert CONFLICT in codes(bench)


def test_spoofed_responses_of_ours_are_no_requests(bench):
    """A forged positive response to security access opens nothing."""
    for text in ("0267020000000000", "0350030000000000", "037F273500000000"):
        bench.send(RESPONSE, bytes.fromhex(text))
        bench.send(REQUEST, bytes.fromhex(text))
    settled(bench)
    server = bench.service.parts.diagnostics.uds.server
    assert server.counters.requests == 0
    assert not server.security.unlocked


def flood(bench: UdsBench, seconds: float, frames: list[bytes], ids: list[int]) -> int:
    """As many frames as a full bus carries, 1,000 at least; how many those were."""
    sent, end = 0, time.monotonic() + seconds
    while time.monotonic() < end or sent < 1000:
        for _ in range(16):
            bench.send(ids[sent % len(ids)], frames[sent % len(frames)])
            sent += 1
        time.sleep(0.002)
    return sent


def throw_away(bus: Any, stop: threading.Event) -> None:
    while not stop.is_set():
        bus.recv(0.1)


HOSTILE = [
    bytes.fromhex(text)
    for text in (
        "0227010000000000",  # a seed without a session
        "0431010000F01100",  # a reset without anything
        "1FFFFFFFFFFFFFFF",  # a request of 4095 bytes
        "1000FFFFFFFF0000",  # one of 4 gigabytes
        "2300000000000000",  # a piece of nothing
        "3000000000000000",  # flow control for nothing
        "0322FD0600000000",  # a response of many frames, never acknowledged
        "FFFFFFFFFFFFFFFF",
    )
]


@pytest.mark.slow
def test_a_flood_of_hostile_frames_neither_delays_the_sensor_nor_fills_the_memory(bench):
    bench.play(1.0)
    # what the virtual bus keeps for us is not of interest: these are read and thrown away
    stop = threading.Event()
    readers = [
        threading.Thread(target=throw_away, args=(bus, stop))
        for bus in (bench.bus, bench.tester_bus)
    ]
    for reader in readers:
        reader.start()
    try:
        flood(bench, 0.5, HOSTILE, [REQUEST, 0x7DF])
        settled(bench)
        gc.collect()
        tracemalloc.start()
        before = tracemalloc.get_traced_memory()[0]
        samples = bench.service.engine.router.sample_counts["accel"]
        sent = flood(bench, 1.0, HOSTILE, [REQUEST, 0x7DF])
        bench.play(2.0)
        settled(bench)
        gc.collect()
        grown = tracemalloc.get_traced_memory()[0] - before
        tracemalloc.stop()
    finally:
        stop.set()
        for reader in readers:
            reader.join()
    assert sent >= 1000
    assert bench.service.engine.router.sample_counts["accel"] == samples + 100
    counters = bench.service.parts.diagnostics.uds.channel.counters
    assert counters["dropped"] > 0
    assert counters["transport_failed"] == 0
    assert grown < 200_000
    with asking(bench.tester_bus) as client:
        time.sleep(0.5)
        assert client.read_data_by_identifier_first(0xFD0C)[1] == counters["dropped"]
    assert bench.service.engine.pipeline.quality == 0
    assert not bench.service.parts.diagnostics.uds.server.security.unlocked
