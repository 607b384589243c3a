"""Find lost time of a stream: samples came, but the clock of their time stamps stood still.

Stream time never goes back. If the clock of the time stamps is set back a little, stream time
stands still until the time stamps have caught up. A rate that is integrated over stream time misses
the rotation during this time. Stream time also stands still for samples that come late or in
batches. In this case, a longer time step comes before or after the samples. Only standing time
without such a longer step is lost.
"""

from __future__ import annotations

import math

STANDS = 0.25
"""Share of the sensor's cycle time below which a time step counts as standing time."""
TOLERATED_S = 0.05
"""Lost time that is not reported: less than the sum of `TOLERATED_S` [s] and `TOLERATED_CYCLES`
cycles. Time stamps may be late by a cycle.
"""
TOLERATED_CYCLES = 1.5
MADE_UP_S = 1.0
"""Time within which a long step compensates for samples that came together, such as late samples
[s].
"""
USUAL_SAMPLES = 200
"""Number of samples over which the cycle time is averaged."""
MIN_SAMPLES = 100
"""Number of samples after which the cycle is known."""
LONGEST_CYCLES = 4.0
"""Largest step that is used for the mean cycle time, in cycles: a silence is not a cycle."""


class LostTime:
    """Watches the time steps from sample to sample of one sensor."""

    def __init__(self) -> None:
        self._cycle = 0.0
        self._samples = 0
        self._together = 0  # samples since time stood still
        self._passed = 0.0  # what passed over them
        self._ahead = 0.0  # time in excess of the samples, not made up for
        self.skipped = 0.0
        """Excess of the last time step over one sensor cycle per sample [s]; 0.0 for a usual
        step."""

    def take_time_step(self, step: float) -> float:
        """Process the time step to a sample [s], not negative. Returns the lost time before this
        sample.

        The result is nearly always 0.0. A loss is known as soon as stream time moves on. Until
        then, `standing` gives the loss.
        """
        self.skipped = 0.0
        if step < STANDS * self._cycle:
            self._together += 1
            self._passed += step
            return 0.0
        n, cycle = self._together + 1, self._cycle
        passed = self._passed + step
        self._together, self._passed = 0, 0.0
        gained = passed - n * cycle
        if n == 1:
            gained = max(gained, 0.0)  # a shorter step is another cycle, not a clock that stands
        if self._samples >= MIN_SAMPLES and gained > LONGEST_CYCLES * cycle:
            self.skipped = gained
        if gained or self._ahead:
            self._ahead = min(self._ahead * math.exp(-passed / MADE_UP_S) + gained, MADE_UP_S)
        if lost := self._beyond_tolerance(-self._ahead):
            self._ahead = 0.0
            return lost
        self._learn(n, passed / n)
        return 0.0

    @property
    def standing(self) -> float:
        """Time [s] that is lost if the clock continues now."""
        samples = self._together * self._cycle
        return self._beyond_tolerance(samples - self._passed - self._ahead) if samples else 0.0

    def _beyond_tolerance(self, lost: float) -> float:
        tolerated = TOLERATED_S + TOLERATED_CYCLES * self._cycle
        return lost if self._samples >= MIN_SAMPLES and lost > tolerated else 0.0

    def _learn(self, n: int, step: float) -> None:
        if self._samples >= MIN_SAMPLES:
            step = min(step, LONGEST_CYCLES * self._cycle)
        else:
            self._ahead = 0.0
        self._samples = min(self._samples + n, USUAL_SAMPLES)
        self._cycle += min(n / self._samples, 1.0) * (step - self._cycle)
