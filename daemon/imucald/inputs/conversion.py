"""Convert the value of a signal to a quantity in SI: apply unit, sign and offset, and check
plausibility.

A value that is not available, implausible, saturated or not finite is rejected with a reason.
Single values and columns give equal results.
"""

from __future__ import annotations

import math
from collections.abc import Hashable
from typing import Final

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.core.samples import DIMENSIONS
from imucald.inputs.units import Unit

OK: Final = 0
REASONS: Final = ("", "not_available", "not_finite", "saturated", "out_of_range", "status")
"""The reason why a value was rejected, by code; code 0 means accepted. "status" means that the
sensor's status signal rejects the value."""
STATUS: Final = 5


class Conversion(Struct, frozen=True):
    """The conversion of a physical value of the database to a quantity.

    SI = sign * (factor * (physical + offset) + unit_offset). `low`, `high`: limits of plausible
    physical values, included. `rails`: physical values from which the sensor is saturated
    (included), or None. `not_available`: raw values that mean "not available". `on_values`,
    `on_above`: values for which a flag is 1. `step`: difference of two neighbouring values in SI; 0
    if not known.
    """

    unit: Unit
    sign: float = 1.0
    offset: float = 0.0
    low: float = -math.inf
    high: float = math.inf
    rails: tuple[float, float] | None = None
    not_available: tuple[int, ...] = ()
    on_values: tuple[float, ...] | None = None
    on_above: float | None = None
    step: float = 0.0

    @property
    def limit(self) -> float:
        """Largest plausible magnitude in SI."""
        return DIMENSIONS[self.unit.dimension].largest

    @property
    def source(self) -> Hashable:
        """A key of the settings that determine the converted value. Settings of the plausibility
        check are not in the key."""
        return self.unit, self.sign, self.offset, self.on_values, self.on_above

    def scalar(self, raw: float | int, physical: float) -> tuple[float, int]:
        """Return (value in SI, code). The value is NaN if the code is not OK."""
        if self.not_available and raw in self.not_available:
            return math.nan, 1
        if not math.isfinite(physical):
            return math.nan, 2
        if self.rails is not None and not self.rails[0] < physical < self.rails[1]:
            return math.nan, 3
        if not self.low <= physical <= self.high:
            return math.nan, 4
        if self.unit.dimension == "flag":
            return float(self._flags(np.array([physical]))[0]), OK
        value = ((physical + self.offset) * self.unit.factor + self.unit.offset) * self.sign
        if not -self.limit <= value <= self.limit:
            return math.nan, 4
        return value, OK

    def array(
        self, raw: NDArray[np.generic], physical: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.int8]]:
        """Return values (N,) in SI (NaN if rejected) and codes (N,)."""
        if self.unit.dimension == "flag":
            values = self._flags(physical)
        else:
            with np.errstate(all="ignore"):
                values = ((physical + self.offset) * self.unit.factor + self.unit.offset) * (
                    self.sign
                )
        codes = np.zeros(len(physical), dtype=np.int8)
        if not self._takes_all(physical):
            with np.errstate(invalid="ignore"):
                codes[~((self.low <= physical) & (physical <= self.high))] = 4
                codes[~((-self.limit <= values) & (values <= self.limit))] = 4
                if self.rails is not None:
                    codes[~((self.rails[0] < physical) & (physical < self.rails[1]))] = 3
            codes[~np.isfinite(physical)] = 2
        for number in self.not_available:
            codes[raw == number] = 1
        if np.count_nonzero(codes):
            values = np.where(codes == OK, values, np.nan)
        return values, codes

    def _takes_all(self, physical: NDArray[np.float64]) -> bool:
        """True if no value is rejected for its size. It is sufficient to check the extreme
        values."""
        if not len(physical):
            return True
        ends = np.minimum.reduce(physical), np.maximum.reduce(physical)  # NaN if any is NaN
        return all(self.scalar(math.nan, float(end))[1] == OK for end in ends)

    def _flags(self, physical: NDArray[np.float64]) -> NDArray[np.float64]:
        if self.on_values is not None:
            on = np.isin(physical, self.on_values)
        elif self.on_above is not None:
            on = physical > self.on_above
        else:
            on = physical != 0.0
        return on.astype(np.float64)
