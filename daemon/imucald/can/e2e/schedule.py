"""When the frames of a cyclic sender are due: what a gap has room for, and what is one too many.

A sender that counts its frames and sends one each cycle is on a schedule: after `step` counts the
next frame is due `step` cycles later. A frame may be late: by jitter, in a batch of a gateway, by a
coarse stamp, behind a queue that stood. What is late is a credit from which frames that follow
closely are paid, and the credit fades. A frame without that credit that comes before 0.4 of its
cycle has passed was not sent by this sender, and a counter that is further ahead than twice what
the time has room for is none of it.

The cycle is learnt from the counts and the times (`LEARN_S`), then tried for as long: a sender
that is on no schedule (frames on change) is judged by its counter alone. Until then the mean so
far says whether a counter that is far ahead is an old frame or a hole. A stated cycle counts like
one seen for `REMEMBERED_S`, so that frames of others at the start do not change it; that of a
database counts as `LEARN_STEPS` cycles and is tried for as many first, as some state one that
nobody keeps. A sender whose frames come early more often than not has another cycle now, which is
learnt again.
"""

from __future__ import annotations

import math

from msgspec import Struct

LEARN, TRIAL, IN_FORCE = range(3)

EARLIEST = 0.4
"""Share of a cycle after which the next frame may come."""
AHEAD = 0.5
"""Each lost frame needs this share of a cycle to have passed: stamps are not exact."""
CREDIT_S = 2.0
"""So much late at most [s]: stamps of whole seconds, and queues that stood for as long."""
FADES_S = 2.0
"""In about this time a credit fades [s]."""
BATCH = 0.03
"""A pause brings this share of itself as extra credit: of two batches, one has a frame more."""
LEARN_S, LEARN_STEPS = 5.0, 50
"""Time [s] and cycles in which a cycle is learnt, and so many without an early frame prove it."""
REMEMBERED_S = 600.0
"""The cycle is the mean of this time at most [s]: clocks warm up; stamps of a second need it."""
MOST_EARLY = 50
"""So many more early frames than others, times the values of the counter, and the cycle is learnt
again: bursts of who counts along do not change what is learnt."""
OWN, WAITS = 3, 1.5
"""So many early frames more were the sender's own than another's: it has another cycle. Within that
many cycles its own frame comes where the early one was another's."""
LONGER, MOST_TRIALS = 4.0, 6
"""Each time that this happens the next trial takes so many times as long, at most so often."""


class Past(Struct):
    """What the next frame of a message is held against.

    t: stamp of the last frame that counted [s]; counter: its counter, -1 for none; data: its bytes,
    if its counter was new. missed: frames known to be missing since. distrust: good frames still to
    be dropped. lost: frames that the counter showed to be lost. due: when the last frame was due,
    never after t [s]. cycle: the mean since begun [s], of so many steps; 0: nothing is known.
    tried: the last early frame of phase TRIAL [s]. early: early frames, see `MOST_EARLY`.
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
    early_t: float = 0.0
    own: int = 0
    trials: int = 0
    due: float = 0.0
    cycle: float = 0.0
    begun: float = math.nan
    steps: float = 0.0
    tried: float = 0.0

    def expect(self, cycle: float, phase: int) -> None:
        """A cycle [s] that is stated, before the first frame; phase: TRIAL, others may be right."""
        self.phase, self.cycle = phase, cycle
        self.steps = float(LEARN_STEPS) if phase == TRIAL else REMEMBERED_S / cycle

    def begin(self, t: float, since: float) -> None:
        """The first frame, or one after a silence: what was held back may follow."""
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
        """When the last frame was due, less what of its lateness has faded since [s]."""
        return self.t - (self.t - self.due) * max(0.0, 1.0 - since / FADES_S)

    def refuse_early(self, t: float, counter: int, modulus: int) -> None:
        """Take note of a frame that came too early; the next is not held against it.

        counter: its value of so many (`modulus`); -1 of 1 where it has none.
        """
        if self.early_counter < 0:
            self.early_counter, self.chain, self.early_t = counter, counter, t
        self.early += 1
        if self.early >= MOST_EARLY * modulus:
            self._learn(t)

    def attribute_early(self, t: float, counter: int, modulus: int) -> None:
        """See by the counter of a frame whose the early one was."""
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
        """Take a frame so many counts after the last one that counted; due: see `due_after`.

        step: 0, its counter is a fault. Nothing is learnt from it then, nor of a silence.
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

    def take(self, t: float, counter: int, data: bytes | bytearray) -> None:
        """Hold the next frame against this one."""
        self.data = b"" if counter < 0 or counter == self.counter else bytes(data)
        self.t, self.counter, self.missed = t, counter, 0

    def _learn(self, t: float) -> None:
        self.phase, self.early, self.own, self.early_counter = LEARN, 0, 0, -1
        self.cycle, self.begun, self.steps = 0.0, t, 0.0
