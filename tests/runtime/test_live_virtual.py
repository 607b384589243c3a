"""The live daemon on python-can's virtual bus."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator

import cantools.database
import numpy as np
import pytest

from imucald.can.columns import CAN_EFF_FLAG, FrameColumns
from imucald.can.link.link import Link
from imucald.can.python_can import can
from imucald.runtime.input_health import LinkHealth
from imucald.runtime.output.output_frames import output_database
from imucald.runtime.replay import Replay
from imucald.runtime.session import make_engine
from imucald.service.live import Daemon, open_link
from simulated_bus import CONFIG, drive_frames, loaded
from threads import in_a_thread

CHANNELS = itertools.count()
HEALTH = 0x645
DBC = CONFIG.parent.parent.parent / "dbc" / "imucald_out.dbc"


class Clock:
    """A monotonic clock that moves when told."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


class Bench:
    """A daemon and, on the same virtual bus, another node."""

    def __init__(self, clock=time.monotonic) -> None:
        channel = f"live-{next(CHANNELS)}"
        config = loaded("published")
        self.engine = make_engine(config, link_health=self.health)
        matches, own = self.engine.router.matches, self.engine.output.can_ids
        self.link: Link = open_link(config, matches, own, "virtual", channel)
        self.daemon = Daemon(self.engine, self.link, clock)
        self.bus = can.Bus(interface="virtual", channel=channel, preserve_timestamps=True)

    def health(self) -> LinkHealth:
        return self.daemon.link_health()

    def send(self, t: float, can_id: int, data: bytes) -> None:
        self.bus.send(
            can.Message(
                timestamp=t,
                arbitration_id=can_id & ~CAN_EFF_FLAG,
                is_extended_id=bool(can_id & CAN_EFF_FLAG),
                data=data,
            )
        )

    def received(self) -> list[tuple[int, bytes]]:
        out = []
        while (message := self.bus.recv(0.0)) is not None:
            out.append((message.arbitration_id, bytes(message.data)))
        return out

    def last_health(self, frames=None) -> dict[str, int]:
        found = self.received() if frames is None else frames
        frames = [data for can_id, data in found if can_id == HEALTH]
        message = cantools.database.load_file(DBC).get_message_by_frame_id(HEALTH)
        return message.decode(frames[-1], decode_choices=False)

    def close(self) -> None:
        self.link.close()
        self.bus.shutdown()


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench(Clock())  # a busy machine holds up no loop whose clock stands still
    yield made
    made.close()


class ListReader:
    """Chunks in place of a log."""

    def __init__(self, chunks):
        self.chunks, self.frames_read, self.rejected = chunks, sum(map(len, chunks)), {}
        self.first_stamp = float(chunks[0].t[0])

    def __iter__(self):
        return iter(self.chunks)


def test_corrected_frames_equal_those_of_replay_byte_for_byte(bench):
    frames = drive_frames().take(slice(0, 24_000))
    sent: list[FrameColumns] = []
    engine = make_engine(loaded("published"))
    chunks = [frames.take(slice(0, 7001)), frames.take(slice(7001, 24_000))]
    Replay(engine, ListReader(chunks), sent.append).run()
    expected = [(can_id, data) for part in sent for _, can_id, data in part.rows()]
    got = []
    for k, frame in enumerate(frames.rows()):
        bench.send(*frame)
        if k % 7 == 0:
            bench.daemon.serve_once(0.0)
            got += bench.received()
    while bench.daemon.serve_once(0.0):
        pass
    got += bench.received()
    assert got == expected
    names = {m.can_id: n for n, m in output_database().messages.items()}
    assert {names[can_id] for can_id, _ in got} >= {
        "IMUCALD_Acceleration",
        "IMUCALD_AngularRate",
        "IMUCALD_Health",
    }
    assert bench.engine.pipeline.estimator.estimate().std == (
        engine.pipeline.estimator.estimate().std
    )


@pytest.mark.slow
def test_a_full_bus_loses_nothing_of_ours(bench):
    """8,000 frames a second, 5 % of them ours: every one is judged, and answered."""
    ours = list(drive_frames().take(slice(0, 800)).rows())
    with in_a_thread(bench.daemon.run, bench.daemon.stop):
        began = time.perf_counter()
        for k, frame in enumerate(ours):
            for j in range(19):
                bench.send(frame[0], 0x700 + j, b"\x00" * 8)
            bench.send(*frame)
            left = began + 20 * (k + 1) / 8000.0 - time.perf_counter()
            if left > 0.0:
                time.sleep(left)
        end = time.perf_counter() + 10.0
        while bench.link.counters.received < len(ours) and time.perf_counter() < end:
            time.sleep(0.02)
    assert bench.link.counters.received == len(ours)
    router = bench.engine.router
    assert router.used + router.rejected.total() == len(ours)
    samples = router.sample_counts["accel"] + router.sample_counts["gyro"]
    answered = [i for i, _ in bench.received() if i in (0x640, 0x641)]
    assert len(answered) == samples


def test_a_heartbeat_says_that_nothing_is_heard_yet():
    clock = Clock()
    bench = Bench(clock)
    try:
        for _ in range(45):
            clock.now += 0.1
            bench.daemon.serve_once(0.0)
        frames = bench.received()
        assert [i for i, _ in frames] == [0x643, 0x644, 0x64D, 0x64E, HEALTH] * 4
        health = bench.last_health(frames)
        assert health["AccelerometerMissing"] == health["SpeedMissing"] == 1
    finally:
        bench.close()


def test_status_goes_on_when_the_bus_falls_silent():
    clock = Clock()
    bench = Bench(clock)
    try:
        for frame in drive_frames().take(slice(0, 2000)).rows():
            bench.send(*frame)
        while bench.daemon.serve_once(0.0):
            pass
        heard = bench.last_health()
        assert heard["AccelerometerMissing"] == heard["SpeedMissing"] == 0
        for _ in range(40):
            clock.now += 0.1
            bench.daemon.serve_once(0.0)
        silent = bench.last_health()
        assert silent["AccelerometerMissing"] == silent["GyroscopeMissing"] == 1
        assert silent["SpeedMissing"] == 1
        for _ in range(300):  # long silence: heartbeats, one a second
            clock.now += 0.1
            bench.daemon.serve_once(0.0)
        assert 20 <= sum(i == HEALTH for i, _ in bench.received()) <= 31
    finally:
        bench.close()


def test_input_that_comes_back_is_calibrated_on():
    clock = Clock()
    bench = Bench(clock)
    try:
        frames = drive_frames()
        first, second = frames.take(slice(0, 2000)), frames.take(slice(2000, 4000))
        for frame in first.rows():
            bench.send(*frame)
        while bench.daemon.serve_once(0.0):
            pass
        for _ in range(80):
            clock.now += 0.1
            bench.daemon.serve_once(0.0)
        for t, can_id, data in second.rows():
            bench.send(t + 8.0, can_id, data)
        bench.received()
        while bench.daemon.serve_once(0.0):
            pass
        health = bench.last_health()
        assert health["AccelerometerMissing"] == health["SpeedMissing"] == 0
        assert bench.engine.timebase.now == pytest.approx(frames.t[3999] - frames.t[0] + 8.0)
    finally:
        bench.close()


@pytest.mark.parametrize("set_back", [0.0, 1.4, 5.0, 8.5])
def test_a_clock_set_back_in_a_silence_refuses_nothing_and_status_goes_on(set_back):
    clock = Clock()
    bench = Bench(clock)
    try:
        frames = drive_frames()
        for frame in frames.take(slice(0, 6000)).rows():
            bench.send(*frame)
        while bench.daemon.serve_once(0.0):
            pass
        for _ in range(80):
            clock.now += 0.1
            bench.daemon.serve_once(0.0)
        bench.received()
        second = frames.take(slice(6000, 14_000))
        for t, can_id, data in second.rows():
            bench.send(t + 8.0 - set_back, can_id, data)
        while bench.daemon.serve_once(0.0):
            pass
        seconds = int(second.t[-1] - second.t[0])
        assert sum(i == HEALTH for i, _ in bench.received()) in range(seconds, seconds + 3)
        assert bench.engine.router.rejected["too_fast"] == 0
    finally:
        bench.close()


@pytest.mark.parametrize("set_back", [0.3, 0.9])
def test_status_frames_keep_their_time_when_the_clock_is_set_back_a_little(set_back):
    bench = Bench(Clock())
    try:
        frames = drive_frames().take(slice(0, 8000))
        sent: list[float] = []
        for t, can_id, data in frames.rows():
            since = t - frames.t[0]
            bench.send(t - set_back * (since > 5.0), can_id, data)
            bench.daemon.serve_once(0.0)
            sent += [since] * sum(i == HEALTH for i, _ in bench.received())
        assert max(np.diff(sent)) < 1.15
        assert bench.engine.timebase.now == pytest.approx(frames.t[-1] - frames.t[0], abs=0.02)
    finally:
        bench.close()


def test_another_sender_on_our_ids_raises_the_alarm_and_is_not_heard():
    clock = Clock()
    bench = Bench(clock)
    try:
        frames = list(drive_frames().take(slice(0, 3000)).rows())
        for frame in frames[:1500]:
            bench.send(*frame)
        bench.send(frames[1500][0], 0x640, bytes(8))
        bench.daemon.serve_once(0.0)
        while bench.daemon.serve_once(0.0):
            pass
        used = bench.engine.router.used
        for frame in frames[1500:]:
            bench.send(*frame)
        while bench.daemon.serve_once(0.0):
            pass
        assert bench.last_health()["IdConflict"] == 1
        assert bench.link.counters.conflicts == 1
        assert used == 1500
        clock.now += 11.0  # the alarm ends ten seconds after the last of them
        later = list(drive_frames().take(slice(3000, 6000)).rows())
        for frame in later:
            bench.send(*frame)
        while bench.daemon.serve_once(0.0):
            pass
        assert bench.last_health()["IdConflict"] == 0
    finally:
        bench.close()


def test_it_stops_soon_and_hears_nothing_more(bench):
    with in_a_thread(bench.daemon.run, bench.daemon.stop) as thread:
        began = time.perf_counter()
        bench.daemon.stop()
        thread.join(2.0)
        assert not thread.is_alive()
        assert time.perf_counter() - began < 1.0
    bench.received()
    bench.send(*next(drive_frames().rows()))
    assert bench.received() == []
    assert np.isfinite(bench.engine.timebase.now)
