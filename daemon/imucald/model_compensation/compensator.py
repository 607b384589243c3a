"""Convert raw values of one sensor to true values: three axes, four wheel speeds, or one number."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from imucald.core.arrays import Array, Flags, Index
from imucald.core.rotations import times
from imucald.core.samples import QUANTITIES
from imucald.model.sensors import REFERENCE_DEGC
from imucald.model_compensation.terms import IDENTITY, NO_RAIL, ScalarTerms, TriadTerms


class Compensator:
    """Removes bias, scale and cross-axis errors, and refuses clipped and implausible samples.

    The same code corrects single samples and columns. limit: largest plausible absolute value of a
    component, in SI. undone: function that removes the gain from all components; None: no gain.
    """

    def __init__(
        self,
        limit: float,
        bias: Sequence[float],
        undone: Callable[[Sequence[Any]], Sequence[Any]] | None,
        rail: tuple[float, float] = NO_RAIL,
        per_kelvin: Sequence[float] = (),
    ) -> None:
        self.follows_temperature = any(per_kelvin)
        self._limit, self._undone, self._rail = limit, undone, rail
        self._reference, self._per_kelvin = bias, per_kelvin
        self._bias = bias  # at the present temperature

    @staticmethod
    def of_triad(channel: str, terms: TriadTerms) -> Compensator:
        """Return the compensator of a sensor with three axes."""
        undone = None if terms.inverse == IDENTITY else partial(times, terms.inverse)
        limit = QUANTITIES[channel].largest
        return Compensator(limit, terms.bias, undone, terms.rail, terms.bias_temperature)

    @staticmethod
    def of_scalar(channel: str, terms: ScalarTerms) -> Compensator:
        """Return the compensator of a signal with one component."""
        undone = partial(_divided, (1.0 + terms.scale,))
        return Compensator(QUANTITIES[channel].largest, (terms.offset,), undone, terms.rail)

    @staticmethod
    def of_wheels(scales: Sequence[float]) -> Compensator:
        """Return the compensator of the wheel speeds."""
        undone = partial(_divided, tuple(1.0 + scale for scale in scales))
        return Compensator(QUANTITIES["wheel_speeds"].largest, (0.0,) * len(scales), undone)

    def set_temperature(self, degc: float) -> None:
        """Set the sensor's temperature from now on [degC]."""
        warmer = degc - REFERENCE_DEGC
        pairs = zip(self._reference, self._per_kelvin, strict=True)
        self._bias = tuple(a + warmer * x for a, x in pairs)

    def sample(self, t: float, v: Sequence[float]) -> Sequence[float] | None:
        """Correct one sample at t [s]; None if it is refused."""
        found, refused = self._corrected(v, self._bias)
        return None if refused else tuple(found)

    def columns(self, v: Array, before: Index, degc: Array) -> tuple[Array, Flags]:
        """Correct samples (N,) or (N, width) as `sample` does. Returns the results and flags (N,)
        of the refused samples.

        before: for each sample, the number of temperatures that arrived before it. degc: (M,)
        temperatures [degC].
        """
        bias = np.array([self._bias])
        if self.follows_temperature:
            warmer = (degc - REFERENCE_DEGC)[:, None]
            own = np.array([self._reference]) + warmer * np.array([self._per_kelvin])
            bias = np.concatenate([bias, own])[before]
        found, refused = self._corrected(list(v.T) if v.ndim == 2 else [v], list(bias.T))
        return np.stack(found, axis=1) if v.ndim == 2 else found[0], refused

    def _corrected(self, v: Sequence[Any], bias: Sequence[Any]) -> tuple[Sequence[Any], Any]:
        """Return the components of one sample, or of columns, and whether they are refused. NaN is
        refused too."""
        refused = False
        low, high = self._rail
        if self._rail != NO_RAIL:
            for size in map(abs, v):
                refused = refused | ((low <= size) & (size <= high))
        found: Sequence[Any] = [x - b for x, b in zip(v, bias, strict=True)]
        if self._undone is not None:
            found = self._undone(found)
        for x in found:
            refused = refused | (abs(x) > self._limit) | (x != x)  # noqa: PLR0124
        return found, refused


def _divided(gains: Sequence[float], v: Sequence[Any]) -> Sequence[Any]:
    return [x / gain for x, gain in zip(v, gains, strict=True)]
