"""Compute when the frames of a cyclic sender are due, to detect lost frames and extra frames.

A cyclic sender follows a schedule: a frame whose counter is `step` higher is due `step` cycles
later. A frame may be late because of jitter, a gateway that sends batches, a coarse time stamp, or
a blocked queue. The delay is stored as a credit. The credit allows the next frames to follow
closely, and it decreases with time. A frame is not from this sender if there is no credit and fewer
than 0.4 cycles have passed. A frame is also not from this sender if its counter is more than twice
as far ahead as the elapsed time allows.

The cycle is learnt from counters and times during `LEARN_S`, and then tried for the same time. A
sender without a schedule (frames on change) is checked only by its counter. Until the cycle is
known, the mean cycle so far decides whether a counter far ahead is an old frame or a gap.

A stated cycle has the weight of a cycle observed for `REMEMBERED_S`, so foreign frames at the start
do not change it. A cycle from a database has the weight of `LEARN_STEPS` cycles and is tried for as
many cycles first, because some databases state a wrong cycle. If most frames of a sender are early,
its cycle has changed and is learnt again.
"""

from __future__ import annotations

import math

from msgspec import Struct

LEARN, TRIAL, IN_FORCE = range(3)

EARLIEST = 0.4
"""Share of a cycle after which the next frame may arrive."""
AHEAD = 0.5
"""Minimum time per lost frame, as a share of a cycle, because time stamps are not exact."""
CREDIT_S = 2.0
"""Largest credit [s]. The credit covers time stamps of whole seconds and queues blocked for this
time."""
FADES_S = 2.0
"""Time in which a credit decreases to zero [s]."""
BATCH = 0.03
"""Extra credit after a pause, as a share of the pause. One batch of frames may have one frame more
than another batch."""
LEARN_S, LEARN_STEPS = 5.0, 50
"""Time [s] and number of cycles for learning a cycle. The cycle is confirmed if no frame is early
for the same time and number of cycles."""
REMEMBERED_S = 600.0
"""Longest averaging time of the cycle [s]. The time is limited because clocks drift while they warm
up. The time is this long because of time stamps in whole seconds."""
MOST_EARLY = 50
"""The cycle is learnt again if early frames exceed other frames by this number times the number of
counter values. Bursts from another sender that uses the same counter do not change the cycle."""
OWN, WAITS = 3, 1.5
"""OWN: the cycle has changed if the number of early frames from the sender itself exceeds the
number from other senders by this. WAITS: after a foreign early frame, the sender's own frame
arrives within this number of cycles."""
LONGER, MOST_TRIALS = 4.0, 6
"""LONGER: each change of the cycle multiplies the duration of the next trial by this factor.
MOST_TRIALS: largest number of times that the factor is applied."""


HELD_S = 2.0
"""A sender is trusted again this time after the last sign of another sender [s]."""


class Past(Struct):
    """The state of a message with which its next frame is compared.

    t: time stamp of the last counted frame [s]. counter: counter of this frame, -1 if none. data:
    bytes of this frame, if its counter was new. missed: number of frames known to be missing since
    this frame. distrust: number of good frames still to be dropped. lost: number of lost frames
    according to the counter. due: time when the last frame was due [s], not after t. cycle: mean
    cycle [s] over `steps` steps since `begun`; 0 if not known. tried: time of the last early frame
    in phase TRIAL [s]. early: number of early frames, see `MOST_EARLY`. overtaken: bytes of the
    last counted frame, if a frame with an older counter came after it.
    contradicted: time of the last frame that showed another sender [s].
    """

    t: float = math.nan
    counter: int = -1
    data: bytes = b""
    missed: int = 0
    distrust: int = 0
    lost: int = 0
    phase: int = LEARN
    early: int = 0
    early_counter: int = -1
    chain: int = -1
    overtaken: bytes = b""
    early_t: float = 0.0
    contradicted: float = -math.inf
    own: int = 0
    trials: int = 0
    due: float = 0.0
    cycle: float = 0.0
    begun: float = math.nan
    steps: float = 0.0
    tried: float = 0.0

    def expect(self, cycle: float, phase: int) -> None:
        """Set a stated cycle [s] before the first frame. phase: TRIAL if it may be wrong."""
        self.phase, self.cycle = phase, cycle
        self.steps = float(LEARN_STEPS) if phase == TRIAL else REMEMBERED_S / cycle

    def begin(self, t: float, since: float) -> None:
        """Process the first frame, or the first frame after a silence. Delayed frames may follow
        closely."""
        if math.isnan(since) and self.phase != LEARN:
            self.due = t - 0.5 * CREDIT_S
            self.begun = t - self.steps * self.cycle
            self.tried = t - max(0.0, LEARN_S - LEARN_STEPS * self.cycle)
        elif since > 0.0:
            self.due = t - min(since, CREDIT_S)
            self.begun += since
        else:
            self.due = t
            self._learn(t)

    def due_after(self, since: float) -> float:
        """Return the time when the last frame was due [s]. The delay of this frame is reduced in
        proportion to the time since then."""
        return self.t - (self.t - self.due) * max(0.0, 1.0 - since / FADES_S)

    def refuse_early(self, t: float, counter: int, modulus: int) -> None:
        """Register a frame that arrived too early. The next frame is not compared with this frame.

        counter: counter of the frame, below `modulus`. Without a counter: -1, with modulus 1.
        """
        if self.early_counter < 0:
            self.early_counter, self.chain, self.early_t = counter, counter, t
        self.early += 1
        if self.early >= MOST_EARLY * modulus:
            self._learn(t)

    def attribute_early(self, t: float, counter: int, modulus: int) -> None:
        """Decide by a frame's counter whether the early frame was from the same sender."""
        if self.early_counter < 0:
            return
        goes_on = counter == (self.chain + 1) % modulus
        if t - self.early_t > WAITS * self.cycle:
            self.early_counter = -1
            self.own += 1
            if self.own >= OWN:
                self.trials = min(self.trials + 1, MOST_TRIALS)
                self._learn(t)
        elif counter == self.early_counter:
            self.early_counter = -1
            if not goes_on and self.own > 0:
                self.own -= 1
        elif goes_on:
            self.chain = counter

    def go_on(self, t: float, since: float, due: float, step: int) -> None:
        """Process a frame `step` counts after the last counted frame; due: see `due_after`.

        step: 0 means that the counter is faulty. The cycle is then not learnt from this frame. A
        frame after a silence is also not used for the cycle.
        """
        counts = step or 1
        due += counts * self.cycle - BATCH * max(0.0, since - (counts + 1) * self.cycle)
        self.due = max(min(due, t), t - CREDIT_S)
        if step:
            self.early = max(0, self.early - 1)
        if not step or self.distrust or since > CREDIT_S:
            self.begun += since
            return
        self.steps += step
        passed = t - self.begun
        if self.phase == LEARN:
            self.due, self.cycle = t, passed / self.steps
            if not (passed >= LEARN_S and self.steps >= LEARN_STEPS):
                return
            self.phase, self.tried, self.due = TRIAL, t, t - 0.5 * CREDIT_S
        self.cycle = passed / self.steps
        if passed > REMEMBERED_S:
            self.begun += 0.5 * passed
            self.steps *= 0.5
        proved = max(LEARN_S, LEARN_STEPS * self.cycle) * LONGER**self.trials
        if self.phase == TRIAL and t - self.tried >= proved:
            self.phase = IN_FORCE

    def store_frame(self, t: float, counter: int, data: bytes | bytearray) -> None:
        """Store this frame for the comparison with the next frame."""
        self.data = b"" if counter < 0 or counter == self.counter else bytes(data)
        self.t, self.counter, self.missed = t, counter, 0

    def _learn(self, t: float) -> None:
        self.phase, self.early, self.own, self.early_counter = LEARN, 0, 0, -1
        self.cycle, self.begun, self.steps = 0.0, t, 0.0
