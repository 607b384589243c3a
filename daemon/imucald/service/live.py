"""The live daemon: one loop without threads that receives, calibrates, corrects and sends.

Received frames are handled at once. If no frames arrive, ticks end by the clock, so that status
frames continue and missing inputs are detected. Until the first configured frame arrives, the
daemon sends a status frame once per second. A frame that waited too long is not corrected. Frames
wait too long if the loop was blocked or is too slow.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from imucald.can.columns import FrameColumns, IdMatch
from imucald.can.link.link import Frame, Link, LinkEvent
from imucald.can.link.port import MAX_HOLD
from imucald.config import LoadedConfig
from imucald.runtime.engine import Engine
from imucald.runtime.input_health import LinkHealth
from imucald.runtime.timebase import FORWARD_STEP

if TYPE_CHECKING:
    from imucald.service.uds_on_bus import BusUds

WAIT_S = 0.05
"""Longest wait for a frame [s]. This time limits the delay until a silent bus or a stop is
noticed."""
IDLE_S = 0.5
"""Silence on the bus after which ticks end by the clock [s]. This time is far longer than the
delivery of any frame."""
CONFLICT_S = 10.0
"""Time for which another sender of our ids is reported [s]."""
STRIDE = 16
"""Number of frames handled between two readings of the clock. Handling this number of frames takes
1.3 ms natively and 80 ms under emulation."""
MAX_AGE_S = 2.0 * MAX_HOLD
"""A frame is not corrected if it has waited for longer than this [s]. The age is twice the time
that a corrected frame may wait to be sent, and twice `WAIT_S`. A loop that is fast enough has read
all waiting frames far more often.
"""
HEARTBEAT_S = 1.0
"""Period of status frames before the first configured frame, and during a long silence [s]."""
RECENT_S = 1.0
"""Time for which lost frames and frames that were not sent are reported [s]."""


def open_link(
    loaded: LoadedConfig,
    matches: Sequence[IdMatch],
    own_ids: frozenset[int],
    interface: str | None = None,
    channel: str | None = None,
    on_event: Callable[[LinkEvent], None] | None = None,
) -> Link:
    """Open the bus of the configuration. `interface` and `channel` override the configuration.
    Raises LinkError."""
    bus = loaded.config.bus
    unbound = [IdMatch(m.can_id, m.mask) for m in matches]  # one live bus: any channel
    return Link(
        interface or bus.interface,
        channel or bus.channel,
        receive=unbound,
        own_ids=own_ids,
        fd=bus.fd,
        bitrate=bus.bitrate,
        options=bus.options,
        on_event=on_event,
    )


def send_columns(link: Link, frames: FrameColumns) -> None:
    """Send columns of frames, in order."""
    ids, lengths = frames.can_id.tolist(), frames.length.tolist()
    for can_id, length, data in zip(ids, lengths, frames.data, strict=True):
        link.send(can_id, data[:length].tobytes())


@dataclass
class _Recent:
    """Returns whether a counter has increased within a limited time."""

    hold: float
    _value: int = 0
    _until: float = field(default=float("-inf"))

    def update(self, value: int, now: float) -> bool:
        if value != self._value:
            self._value = value
            self._until = now + self.hold
        return now < self._until


class Daemon:
    """Runs an engine on a link until `stop` is called.

    clock: monotonic [s]. extra: the diagnostic server; frames with its ids are not passed to the
    engine. max_age: largest age of frames that are corrected [s], see `MAX_AGE_S`.
    """

    def __init__(
        self,
        engine: Engine,
        link: Link,
        clock: Callable[[], float] = time.monotonic,
        extra: BusUds | None = None,
        max_age: float = MAX_AGE_S,
    ) -> None:
        self.engine = engine
        engine.output.prepare()
        engine.timebase.is_live = True
        self.link = link
        self.stopping = False
        self._clock = clock
        self.serve(extra)
        self._lost = _Recent(RECENT_S)
        self._conflict = _Recent(CONFLICT_S)
        self.between: Callable[[], None] = lambda: None
        """Function that is called every `STRIDE` frames of a batch, for tasks that cannot wait for
        the end of the batch."""
        self._unsent = _Recent(RECENT_S)
        self._backlog = Backlog(clock(), max_age)
        self._last_frame = clock()
        self._next_heartbeat = clock()

    def serve(self, extra: BusUds | None) -> None:
        """Replace the diagnostic server."""
        self._extra = extra
        self._extra_ids = frozenset[int]() if extra is None else extra.ids

    def link_health(self) -> LinkHealth:
        """Return the health of the link for the health frame."""
        counters, now = self.link.counters, self._clock()
        return LinkHealth(
            lost=counters.lost,
            frames_lost=self._lost.update(counters.lost + counters.late, now),
            id_conflict=self._conflict.update(counters.conflicts, now),
            send_failed=self._unsent.update(sum(counters.send_errors.values()), now),
        )

    def run(self) -> None:
        """Run the loop until `stop` is called."""
        while not self.stopping:
            self.serve_once()

    def stop(self) -> None:
        """Request the end of the loop. The loop ends within `WAIT_S`. The call is safe in a signal
        handler.
        """
        self.stopping = True

    def serve_once(self, wait: float = WAIT_S) -> int:
        """Receive frames once, and handle them. Return the number of frames."""
        extra, extra_ids, ours = self._extra, self._extra_ids, 0
        frames = self.link.receive(wait if extra is None else min(wait, extra.wait))
        now, backlog = self._clock(), self._backlog
        waited = backlog.read(frames, self.link.is_empty, now)
        send, handle = self.link.send, self.engine.frame
        for start in range(0, len(frames), STRIDE):
            if start:
                self.between()
                now = self._clock()
                waited = backlog.may_be_late(now)
            for t, can_id, data in frames[start : start + STRIDE]:
                if extra is not None and can_id in extra_ids:
                    answer = extra.frame(can_id, data)
                else:
                    ours += 1
                    if waited and backlog.is_late(t, now := self._clock()):
                        self.link.counters.late += 1
                        answer = handle(t, can_id, data, now)
                    else:
                        before, answer = now, handle(t, can_id, data)
                        now = self._clock()
                        if now - before > backlog.max_age:  # held up while it was handled
                            waited, answer = True, []
                            self.link.counters.late += 1
                for out_id, out in answer:
                    send(out_id, out)
        for out_id, out in () if extra is None else extra.poll():
            send(out_id, out)
        if ours:
            self._last_frame = now
        elif now - self._last_frame > IDLE_S:
            self._idle(now)
        return len(frames)

    @property
    def silent_s(self) -> float:
        """Time since the last frame of a configured message [s]. Before the first frame: time since
        the start."""
        return max(self._clock() - self._last_frame, 0.0)

    def _idle(self, now: float) -> None:
        """Advance stream time by the monotonic clock if no frame has arrived for `IDLE_S`."""
        # The time lags by IDLE_S, so that a frame in transit is not late.
        elapsed = now - self._last_frame - IDLE_S
        engine = self.engine
        if engine.timebase.started and elapsed < FORWARD_STEP:
            out = engine.idle(elapsed)
            self._next_heartbeat = now
        elif now >= self._next_heartbeat:
            self._next_heartbeat = now + HEARTBEAT_S
            out = engine.heartbeat()
        else:
            return
        for can_id, data in out:
            self.link.send(can_id, data)


class Backlog:
    """Decides which frames are too old to be corrected. The clock of the time stamps may be any
    clock.

    The clock of the time stamps may be wrong, may be set at any time, or may be the clock of an
    adapter. Only the loop's own clock is reliable: every waiting frame arrived after the last time
    at which the loop had read all frames. The first frame after this time is assumed to have
    arrived at this time. The ages of later frames follow from the differences between their stamps
    and the stamp of the first frame. The computed age is therefore too large, by at most the
    silence before the first frame. If the clock of the stamps was set forward in between, frames
    seem too new. In this case the wall clock decides, if it is the clock of the stamps.

    now: monotonic [s], here and in all methods. max_age: largest age of a frame that is corrected
    [s]. wall: the system's wall clock [s].
    """

    def __init__(self, now: float, max_age: float, wall: Callable[[], float] = time.time) -> None:
        self.max_age = max_age
        self._wall = wall
        self._read_at = self._since = now
        self._is_empty = True
        self._first = math.inf  # stamp of the first frame that came after `_since`

    def read(self, frames: Sequence[Frame], is_empty: bool, now: float) -> bool:
        """Register the frames that were just read. Return whether any of them can be too old.

        is_empty: True if no frame waits after this read.
        """
        if self._is_empty:
            self._since = self._read_at
            self._first = frames[0][0] if frames else math.inf
        elif frames and self._first == math.inf:
            self._first = frames[0][0]
        self._is_empty = is_empty
        self._read_at = now
        return self.may_be_late(now)

    def may_be_late(self, now: float) -> bool:
        """Return whether any frame of the last read can be too old at time `now`."""
        return now - self._since > self.max_age

    def is_late(self, stamp: float, now: float) -> bool:
        """Return whether a frame of the last read is too old at time `now`."""
        waited = now - self._since
        if waited - (stamp - self._first) > self.max_age:
            return True
        return self.max_age < self._wall() - stamp <= waited


MAX_SLEW = 0.1
"""Largest relative change of a clock's rate while the system corrects its time gradually (slewing):
adjtimex(2), `tick`.
"""
LEAST_S = 0.1
"""Smallest step of a clock that can be distinguished from slewing, for readings one second apart
[s]."""


def steady_clock() -> float:
    """Return the time since the boot [s], including suspended time if the system counts it."""
    return time.clock_gettime(getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC))


class ClockWatch:
    """Detects that the system's clock was set. The clock is compared with a clock that is never
    set. wall, steady: functions that return both times [s].
    """

    def __init__(
        self, wall: Callable[[], float] = time.time, steady: Callable[[], float] = steady_clock
    ) -> None:
        self._wall, self._steady = wall, steady
        self.count = 0
        """Number of times that the clock was set."""
        self._low, self._high, self._at = self._ahead()

    def _ahead(self) -> tuple[float, float, float]:
        """Return lower and upper bound of the difference wall clock minus steady clock, and the
        steady clock [s]. The difference has bounds because the process may be interrupted between
        the readings.
        """
        before = self._steady()
        wall = self._wall()
        after = self._steady()
        return wall - after, wall - before, after

    def look(self) -> float | None:
        """Return the step by which the clock was set since the last call [s]; None if it was not
        set."""
        low, high, at = self._ahead()
        slewed = max(MAX_SLEW * (at - self._at), LEAST_S)
        forward, back = low - self._high, high - self._low
        self._low, self._high, self._at = low, high, at
        if forward <= slewed and back >= -slewed:
            return None
        self.count += 1
        return forward if forward > slewed else back
