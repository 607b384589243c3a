"""A loop that was held up or cannot keep up: old samples are learnt from and never sent as good."""

from __future__ import annotations

import io
import itertools
import random
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import can
import pytest

import shuttle
from feed_bench import sensor_frame
from imucald.can.dbc.decode import compile_decode
from imucald.can.link.link import Frame
from imucald.can.logs.log_reader import LogReader
from imucald.runtime.engine import Engine
from imucald.runtime.output.output_frames import output_database
from imucald.runtime.session import make_engine, open_config
from imucald.service.announcements import Announcements
from imucald.service.journal import Journal
from imucald.service.live import MAX_AGE_S, Daemon
from service_bench import Bench

ACCEL = 0x200
CORRECTED, HEALTH, ATTITUDE = 0x640, 0x645, 0x646
EPOCH = 1.7e9
CYCLE_S = 0.01
STATUS_HZ = 10
GOOD = {2, 3}


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


class Node:
    """The sensor beside a calibrated daemon, on one virtual bus and by one clock."""

    def __init__(self, folder: Path) -> None:
        bench = Bench(folder)
        self.service = bench.service()
        bench.drive(self.service)
        self.service.orders.hold("the test")
        self.clock = Clock()
        self.engine, self.link = self.service.engine, self.service.link
        self.service.daemon = self.daemon = Daemon(self.engine, self.link, self.clock)
        self.bus = can.Bus(interface="virtual", channel=self.link.channel, preserve_timestamps=True)
        self.noise = random.Random(1)
        self.drive(0.5, step=True)

    def drive(self, seconds: float, step: bool) -> None:
        """The sensor sends for a while; step: the loop takes each frame at once."""
        for _ in range(round(seconds / CYCLE_S)):
            self.clock.now += CYCLE_S
            message = can.Message(
                timestamp=EPOCH + self.clock.now,
                arbitration_id=ACCEL,
                is_extended_id=False,
                data=sensor_frame(self.noise),
            )
            self.bus.send(message)
            if step:
                self.daemon.serve_once(0.0)

    def heard(self) -> list[tuple[int, bytes]]:
        found = []
        while (message := self.bus.recv(0.0)) is not None:
            found.append((message.arbitration_id, bytes(message.data)))
        return found

    def close(self) -> None:
        self.bus.shutdown()
        self.service.close()


@pytest.fixture
def node(tmp_path: Path) -> Iterator[Node]:
    made = Node(tmp_path)
    yield made
    made.close()


def qualities(frames: list[tuple[int, bytes]]) -> list[int]:
    return [data[6] & 0xF for can_id, data in frames if can_id == CORRECTED]


def counters(frames: list[tuple[int, bytes]], can_id: int) -> list[int]:
    return [data[6] >> 4 for i, data in frames if i == can_id]


def frames_lost(frames: list[tuple[int, bytes]]) -> float | None:
    plan = compile_decode(output_database().message("IMUCALD_Health"), ["FramesLost"])
    return plan.decode([data for can_id, data in frames if can_id == HEALTH][-1])[0]


@pytest.mark.parametrize("held_s", [0.3, 2.5])
def test_after_a_hold_up_only_fresh_samples_are_good_and_no_burst_of_old_ones_comes(node, held_s):
    assert set(qualities(node.heard())) <= GOOD
    samples = node.engine.router.sample_counts["accel"]
    node.drive(held_s, step=False)
    node.daemon.serve_once(0.0)
    frames = node.heard()
    fresh = round(MAX_AGE_S / CYCLE_S)
    found = Counter(quality in GOOD for quality in qualities(frames))
    assert fresh - 1 <= found[True] <= fresh + 1
    assert 1 <= found[False] <= 2, "one not available says why nothing came"
    assert qualities(frames)[0] == 0
    statuses = sum(can_id == HEALTH for can_id, _ in frames)
    assert 1 <= statuses <= 3, "the newest, not one of each tick"
    assert node.engine.router.sample_counts["accel"] == samples + round(held_s / CYCLE_S)
    for can_id in (CORRECTED, HEALTH):
        steps = counters(frames, can_id)
        assert all((b - a) % 16 == 1 for a, b in itertools.pairwise(steps))
    node.drive(0.5, step=True)
    assert set(qualities(node.heard())) <= GOOD


def test_late_frames_are_counted_and_raise_the_flag_for_a_second(node):
    node.heard()
    assert node.service.status()["link"]["late"] == 0
    node.drive(2.5, step=False)
    node.daemon.serve_once(0.0)
    status = node.service.status()
    assert 239 <= status["link"]["late"] <= 241
    assert status["health"]["frames_lost"]
    assert status["health"]["lost"] == 0
    assert frames_lost(node.heard()) == 1.0
    node.drive(1.5, step=True)
    assert frames_lost(node.heard()) == 0.0


def test_a_hold_up_while_a_frame_is_handled_lets_neither_it_nor_those_behind_it_pass(node):
    node.heard()
    handle, held = node.engine.frame, iter([0.0, 0.0, 2.5])

    def handled(*frame):
        node.clock.now += next(held, 0.0)
        return handle(*frame)

    node.engine.frame = handled
    node.drive(0.08, step=False)
    node.daemon.serve_once(0.0)
    assert [quality in GOOD for quality in qualities(node.heard())] == [True, True, False]
    assert node.link.counters.late == 6


def test_a_short_hold_up_is_no_matter(node):
    node.heard()
    node.drive(0.09, step=False)
    node.daemon.serve_once(0.0)
    found = qualities(node.heard())
    assert len(found) == 9
    assert set(found) <= GOOD
    assert node.link.counters.late == 0


def test_a_loop_that_cannot_keep_up_says_not_available_and_its_state_goes_on(node):
    """Frames come twice as fast as they are handled, and there are always more of them."""
    node.heard()
    handle, clock = node.engine.frame, node.clock
    began = came = clock.now

    def slow(*frame):
        clock.now += 2.0 * CYCLE_S
        return handle(*frame)

    def read(_: float) -> list[Frame]:
        nonlocal came
        stamps = [EPOCH + came + CYCLE_S * (i + 1) for i in range(50)]
        came += 50 * CYCLE_S
        clock.now = max(clock.now, came)
        return [(stamp, ACCEL, sensor_frame(node.noise)) for stamp in stamps]

    node.engine.frame, node.link.receive, node.link.is_empty = slow, read, False
    while clock.now < began + 10.0:
        node.daemon.serve_once(0.0)
    frames, seconds = node.heard(), clock.now - began
    found = Counter(quality in GOOD for quality in qualities(frames))
    assert found[True] <= 2 * MAX_AGE_S / CYCLE_S, "at the beginning"
    assert 0.4 / CYCLE_S <= found[False] / seconds <= 1.1 / CYCLE_S
    statuses = sum(can_id == HEALTH for can_id, _ in frames)
    assert 0.4 * STATUS_HZ <= statuses / seconds <= 1.1 * STATUS_HZ
    assert frames_lost(frames) == 1.0


def test_attitude_of_a_late_tick_is_not_sent_and_its_counter_does_not_jump(tmp_path):
    config = shuttle.write(tmp_path, cycles=2)
    config.write_text(config.read_text() + "attitude:\n  enabled: true\n")
    sent = {is_late: attitude_frames(config, is_late) for is_late in (False, True)}
    before = [payload for t, payload in sent[True] if t <= 10.0]
    after = [payload for t, payload in sent[True] if t > 12.0]
    assert before == [payload for t, payload in sent[False] if t <= 10.0]
    assert len(before) + len(after) == len(sent[True]), "none between"
    assert len(after) > 10
    assert ((after[0][6] >> 4) - (before[-1][6] >> 4)) % 16 == 1
    values = [[payload[:6] for t, payload in sent[late] if t > 12.0] for late in (False, True)]
    assert values[0] == values[1], "it was learnt from all the same"


def attitude_frames(config: Path, is_late: bool) -> list[tuple[float, bytes]]:
    """Time in the drive [s] and payload of each attitude frame; those of 10 to 12 s may be late."""
    engine: Engine = make_engine(open_config(config))
    (chunk,) = LogReader([config.parent / "shuttle.log"])
    found = []
    for t, can_id, data in chunk.rows():
        since = t - float(chunk.t[0])
        late = 50.0 if is_late and 10.0 < since <= 12.0 else None
        answer = engine.frame(t, can_id, data, late)
        found += [(since, payload) for out_id, payload in answer if out_id == ATTITUDE]
    return found


def test_late_frames_are_written_into_the_log_once_and_not_each_second(tmp_path):
    log = io.StringIO()
    journal = Journal(log, clock=lambda: 0.0)
    own = Announcements(journal)
    engine = make_engine(open_config(shuttle.write(tmp_path, cycles=1)))
    for late in (0, 40, 40, 80, 120):
        own.update(engine, late, 0.0)
    lines = [line for line in log.getvalue().splitlines() if "too late" in line]
    assert len(lines) == 1
    assert "so far: 40" in lines[0]
