"""Keep repeated samples of a stuck sensor equal after compensation, so that the sensor is still
recognised as stuck.

Terms that change from sample to sample (bias over temperature, effect of force on a gyroscope)
would make a stuck sensor seem to change. A sample that repeats the sample before it therefore gets
the same result.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from imucald.core.arrays import Array, Flags
from imucald.model.section import Vector3

Stage = Callable[[float, Sequence[float]], Sequence[float] | None]
"""Function that takes the time [s] and the raw values of a sample. It returns the new values; None
if the sample is refused."""


def through(stages: Iterable[Stage], t: float, values: Sequence[float]) -> Sequence[float] | None:
    """Pass a sample through all stages and return the result; None if a stage refuses the
    sample."""
    for stage in stages:
        found = stage(t, values)
        if found is None:
            return None
        values = found
    return values


class HeldRepeats:
    """Stores the last raw sample of one sensor and its result.

    Single samples and columns give the same results. tolerance: largest difference between means of
    equal samples.
    """

    def __init__(self, tolerance: float = 0.0) -> None:
        self._tolerance = tolerance
        self._raw: tuple[float, ...] | None = None
        self._result: Vector3 | None = None

    def restart(self) -> None:
        """Restart after a jump of time: the next sample is not a repeat."""
        self._raw = None

    def known(self, raw: Sequence[float]) -> bool:
        """True if a raw sample (3,) repeats the last raw sample. `result` is then its result."""
        if self._raw is None:
            return False
        if not self._tolerance:
            return tuple(raw) == self._raw
        return all(abs(a - b) <= self._tolerance for a, b in zip(raw, self._raw, strict=True))

    @property
    def result(self) -> Vector3 | None:
        """Result of the last sample; None if the last sample was refused."""
        return self._result

    def keep(self, raw: Sequence[float], result: Vector3 | None) -> Vector3 | None:
        """Store a raw sample and its result, and return the result."""
        self._raw, self._result = tuple(raw), result
        return result

    def columns(self, raw: Array, values: Array, refused: Flags) -> tuple[Array, Flags]:
        """Return results (N, 3) and refusals (N,) of raw samples (N, 3). A repeated sample gets the
        earlier result."""
        n = len(raw)
        if n == 0:
            return values, refused
        new = np.ones(n, dtype=bool)
        new[1:] = (raw[1:] != raw[:-1]).any(axis=1)
        new[0] = not self.known(raw[0].tolist())
        # Row 0 of the arrays below is the last result before this call.
        first = np.maximum.accumulate(np.where(new, np.arange(1, n + 1), 0))
        last = self._result
        held = np.zeros(3) if last is None else np.array(last)
        values = np.concatenate([held[None], values])[first]
        refused = np.concatenate([[last is None], refused])[first]
        x, y, z = values[-1].tolist()
        self.keep(raw[-1].tolist(), None if refused[-1] else (x, y, z))
        return values, refused


def held(repeats: HeldRepeats, stages: Sequence[Stage]) -> Stage:
    """Return the stages of a three-axis sensor as one stage, which gives a repeated sample the same
    result as the sample before it."""

    def stage(t: float, v: Sequence[float]) -> Sequence[float] | None:
        if repeats.known(v):
            return repeats.result
        found = through(stages, t, v)
        return repeats.keep(v, None if found is None else (found[0], found[1], found[2]))

    return stage
