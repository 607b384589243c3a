"""Find lost time of a stream: samples came while the clock of their stamps stood still.

Stream time never goes back. If the clock of the stamps is set back a little, stream time stands
until the stamps have caught up. A rate integrated over stream time misses the rotation during this
time. Time also stands still for samples that come late or in batches, but then a longer step comes
before or after. Only time without such a longer step is lost.
"""

from __future__ import annotations

import math

STANDS = 0.25
"""A step shorter than this share of the sensor's cycle means that time stands."""
TOLERATED_S = 0.05
"""A loss of less than this [s] and less than `TOLERATED_CYCLES` is not reported: stamps may be late
by a cycle.
"""
TOLERATED_CYCLES = 1.5
MADE_UP_S = 1.0
"""A long step compensates for samples that came together within about this time [s], such as late
samples.
"""
USUAL_SAMPLES = 200
"""The cycle is the mean step over about this many samples."""
MIN_SAMPLES = 100
"""Number of samples after which the cycle is known."""
LONGEST_CYCLES = 4.0
"""A longer step counts as this many cycles: a silence is not a cycle."""


class LostTime:
    """Watches the steps of time from sample to sample of one sensor."""

    def __init__(self) -> None:
        self._cycle = 0.0
        self._samples = 0
        self._together = 0  # samples since time stood still
        self._passed = 0.0  # what passed over them
        self._ahead = 0.0  # time in excess of the samples, not made up for
        self.skipped = 0.0
        """Excess of the last step over one sensor cycle per sample [s]; 0.0 for a usual step."""

    def take_time_step(self, step: float) -> float:
        """Take the step of time to a sample [s], not negative; return the time lost before it.

        The result is 0.0 nearly always. The loss is known as soon as time moves on; until then see
        `standing`.
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
