"""Convert raw values of one three-axis sensor to true values, in the sensor's own axes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from imucald.core.arrays import Array
from imucald.core.rotations import times, times_columns
from imucald.model.section import Vector3
from imucald.model_compensation.terms import IDENTITY, NO_RAIL, REFERENCE_DEGC, TriadTerms


class TriadCompensator:
    """Removes bias, scale and cross-axis errors, and refuses clipped and implausible samples.

    Single samples and columns give bit-equal results, because the operations have the same order.
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
        x, y, z = v
        if self._rails:
            low, high = self._low, self._high
            if low <= abs(x) <= high or low <= abs(y) <= high or low <= abs(z) <= high:
                return None
        p, q, r = self._bias
        x -= p
        y -= q
        z -= r
        if self._mixes:
            x, y, z = times(self.terms.inverse, (x, y, z))
        limit = self._limit
        if -limit <= x <= limit and -limit <= y <= limit and -limit <= z <= limit:
            return x, y, z
        return None

    def columns(
        self, v: Array, temperatures: tuple[NDArray[np.int64], Array]
    ) -> tuple[Array, NDArray[np.bool_]]:
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
        values = v - bias
        if self._mixes:
            values = times_columns(np.array([self.terms.inverse]), values)
        # not "larger than": NaN must be refused as well
        refused = ~(np.abs(values).max(axis=1) <= self._limit) if len(v) else np.zeros(0, bool)
        if self._rails:
            size = np.abs(v)
            refused |= ((self._low <= size) & (size <= self._high)).any(axis=1)
        return values, refused
