"""How long frames have waited, whatever their stamps' clock does."""

from __future__ import annotations

import pytest

from imucald.can.link.link import Frame
from imucald.service.live import Backlog

MAX_AGE = 0.1
STEP = 0.01
WALL = 1.6e9
"""Wall clock at monotonic time 0."""


class HeldUp:
    """A loop that found the bus empty at 0 and reads again after a while; a frame every 10 ms.

    offset: of the stamps' clock against the wall clock [s]. set_at, set_by: when the stamps' clock
    was set, by how much; is_wall: the wall clock with it.
    """

    def __init__(
        self,
        read_at: float,
        offset: float = 0.0,
        set_at: float = 1e9,
        set_by: float = 0.0,
        is_wall: bool = True,
    ) -> None:
        self.read_at = read_at
        self.came = [0.004 + STEP * i for i in range(int(read_at / STEP))]
        stamps = [WALL + t + offset + set_by * (t > set_at) for t in self.came]
        self.frames: list[Frame] = [(stamp, 0x200, b"") for stamp in stamps]
        self.now = read_at
        set_wall = set_by if is_wall else 0.0
        self.backlog = Backlog(
            0.0, MAX_AGE, lambda: WALL + self.now + set_wall * (self.now > set_at)
        )
        self.backlog.read([], True, 0.0)
        self.backlog.read(self.frames, True, read_at)

    def late(self, at: float) -> list[float]:
        """Ages of the frames that are late at this time [s]."""
        self.now = at
        if not self.backlog.may_be_late(at):
            return []
        return [
            at - came
            for came, (stamp, _, _) in zip(self.came, self.frames, strict=True)
            if self.backlog.is_late(stamp, at)
        ]

    def too_old(self, at: float, slack: float = 0.0) -> int:
        """How many really are, or would be if they were older by `slack`."""
        return sum(at - came + slack > MAX_AGE for came in self.came)


@pytest.mark.parametrize("offset", [0.0, -1.6e9, 3600.0, 0.05], ids=str)
@pytest.mark.parametrize("read_at", [0.02, 0.09, 0.15, 2.5])
def test_exactly_the_old_frames_are_late_whatever_the_clock_says(read_at, offset):
    loop = HeldUp(read_at, offset)
    found = len(loop.late(read_at))
    assert loop.too_old(read_at) <= found <= loop.too_old(read_at, STEP)


def test_frames_grow_old_while_those_before_them_are_handled():
    loop = HeldUp(0.05)
    assert loop.late(0.06) == []
    assert len(loop.late(0.3)) == len(loop.frames)


@pytest.mark.parametrize("set_by", [3600.0, 2.0, 0.5, -0.5, -2.0, -3600.0])
@pytest.mark.parametrize("set_at", [0.3, 1.2, 2.45])
def test_no_old_frame_passes_when_the_clock_is_set_meanwhile(set_at, set_by):
    loop = HeldUp(2.5, set_at=set_at, set_by=set_by)
    late = loop.late(2.5)
    assert len([age for age in late if age > MAX_AGE]) == loop.too_old(2.5)


@pytest.mark.parametrize("set_by", [3600.0, -3600.0, 0.2, -0.2])
def test_a_clock_that_is_set_makes_nothing_late_in_a_loop_that_keeps_up(set_by):
    now = 0.0
    backlog = Backlog(now, MAX_AGE, lambda: WALL + now + set_by)
    for i in range(100):
        now = 0.05 * i
        backlog.read([(WALL + now + set_by * (i > 50), 0x200, b"")], True, now + 0.001)
        assert not backlog.may_be_late(now + 0.001)


def test_a_loop_that_never_finds_the_bus_empty_stays_behind():
    """Twice as many frames come as it handles: what it reads grows older and older."""
    now, came, batch = 0.0, 0.0, 100
    backlog = Backlog(0.0, MAX_AGE, lambda: 0.0)
    for _ in range(50):
        frames: list[Frame] = [(WALL + came + STEP * i, 0x200, b"") for i in range(batch)]
        came += STEP * batch
        now = max(now, came)
        backlog.read(frames, False, now)
        for stamp, _, _ in frames:
            now += 2.0 * STEP
            assert backlog.is_late(stamp, now) == (now - (stamp - WALL) > MAX_AGE + 1e-6)
    backlog.read([], True, now)
    backlog.read([(WALL + now + 0.01, 0x200, b"")], True, now + 0.02)
    assert not backlog.may_be_late(now + 0.02), "it has caught up"
