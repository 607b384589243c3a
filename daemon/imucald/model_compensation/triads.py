"""Convert raw values of one three-axis sensor to true values, in the sensor's own axes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from imucald.core.arrays import Array, Flags, Index
from imucald.core.rotations import times
from imucald.model.section import Vector3
from imucald.model_compensation.terms import IDENTITY, NO_RAIL, REFERENCE_DEGC, TriadTerms


class TriadCompensator:
    """Removes bias, scale and cross-axis errors, and refuses clipped and implausible samples.

    The same code corrects single samples and columns.
    limit: largest plausible absolute value of a component, in SI.
    """

    def __init__(self, terms: TriadTerms, limit: float) -> None:
        self.terms = terms
        self.follows_temperature = any(terms.bias_temperature)
        self._limit = limit
        self._bias: Vector3 = terms.bias  # at the present temperature
        self._mixes = terms.inverse != IDENTITY
        self._low, self._high = terms.rail
        self._rails = terms.rail != NO_RAIL

    def set_temperature(self, degc: float) -> None:
        """Set the sensor's temperature from now on [degC]."""
        warmer = degc - REFERENCE_DEGC
        a, b, c = self.terms.bias
        x, y, z = self.terms.bias_temperature
        self._bias = a + warmer * x, b + warmer * y, c + warmer * z

    def sample(self, t: float, v: Sequence[float]) -> Vector3 | None:
        """Correct one sample at t [s]; None if it is refused."""
        x, y, z, refused = self._corrected(v, self._bias)
        return None if refused else (x, y, z)

    def columns(self, v: Array, temperatures: tuple[Index, Array]) -> tuple[Array, Flags]:
        """Correct samples (N, 3) as `sample` does. Returns the results and flags (N,) of the
        refused samples.

        temperatures: pair of arrays. The first array has, for each sample, the number of
        temperatures that arrived before it. The second array has the temperatures (M,) [degC].
        """
        bias = np.array([self._bias])
        if self.follows_temperature:
            before, degc = temperatures
            warmer = (degc - REFERENCE_DEGC)[:, None]
            own = np.array([self.terms.bias]) + warmer * np.array([self.terms.bias_temperature])
            bias = np.concatenate([bias, own])[before]
        x, y, z, refused = self._corrected(list(v.T), list(bias.T))
        return np.stack((x, y, z), axis=1), refused

    def _corrected(self, v: Sequence[Any], bias: Sequence[Any]) -> tuple[Any, Any, Any, Any]:
        """Return the components of one sample, or of columns, and whether they are refused. NaN is
        refused too."""
        x, y, z = v
        refused = False
        if self._rails:
            low, high = self._low, self._high
            for size in (abs(x), abs(y), abs(z)):
                refused = refused | ((low <= size) & (size <= high))
        p, q, r = bias
        x, y, z = x - p, y - q, z - r
        if self._mixes:
            x, y, z = times(self.terms.inverse, (x, y, z))
        for part in (x, y, z):
            refused = refused | (abs(part) > self._limit) | (part != part)  # noqa: PLR0124
        return x, y, z, refused
