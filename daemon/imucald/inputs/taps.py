"""Taps: what one message, or one raw expression, gives to a channel."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.core.samples import GRAVITY
from imucald.inputs.conversion import STATUS, Conversion

ABSENT = -1
"""Code of a value that the frame does not carry (another multiplexer value)."""

PLANAR_Z = GRAVITY
"""What a planar accelerometer's missing z axis is taken as [m/s^2]: it is level by declaration."""

Raw = Sequence[int | float | None]
Physical = Sequence[float | None]
Columns = Sequence[tuple[NDArray[np.generic], NDArray[np.float64], NDArray[np.bool_] | None]]
"""Raw values, physical values and presence (None: always) of each signal."""


TapColumns = Sequence[tuple[NDArray[np.float64], NDArray[np.int8]]]
"""Values and codes of each tap."""


class Component(Struct, frozen=True):
    """One number of a tap: position among the route's signals, and what is done with it."""

    index: int
    conversion: Conversion


class Status(Struct, frozen=True):
    """A signal of the same message that says whether the values can be used.

    index: position among the route's signals. values: physical ones at which they can.
    """

    index: int
    values: tuple[float, ...]


class Tap(Struct, frozen=True):
    """What a route gives to one channel.

    slots: positions in the channel's values, in the order of components. complete: they are all
    of them. third: what the third axis of a sensor of two is taken as; None: it has three. rank: 0
    is the preferred source. statuses: all must say that the values can be used.
    """

    channel: str
    rank: int
    components: tuple[Component, ...]
    slots: tuple[int, ...]
    complete: bool
    third: float | None = None
    statuses: tuple[Status, ...] = ()

    @property
    def source(self) -> Hashable:
        """Which numbers of the channel it gives, apart from whether they can be used."""
        return self.channel, self.rank, self.slots, self.third

    def scalar(self, raw: Raw, physical: Physical) -> tuple[Sequence[float], int]:
        """Values in SI and code (see `quantities.REASONS`) from the numbers of one frame."""
        values = []
        for component in self.components:
            number = physical[component.index]
            if number is None:
                return (), ABSENT
            value, code = component.conversion.scalar(raw[component.index] or 0, number)
            if code:
                return (), code
            values.append(value)
        for status in self.statuses:
            if physical[status.index] not in status.values:
                return (), STATUS
        if self.third is not None:
            values.append(self.third)
        return values, 0

    def array(self, columns: Columns) -> tuple[NDArray[np.float64], NDArray[np.int8]]:
        """Values (N,) or (N, k) in SI and codes (N,); the first fault of a row counts."""
        n = len(columns[self.components[0].index][1])
        codes = np.zeros(n, dtype=np.int8)
        values = np.empty((n, len(self.components) + (self.third is not None)))
        for i, component in enumerate(self.components):
            raw, physical, present = columns[component.index]
            values[:, i], found = component.conversion.array(raw, physical)
            if present is not None:
                found = np.where(present, found, ABSENT)
            if found.any():
                codes = np.where(codes == 0, found, codes).astype(np.int8)
        for status in self.statuses:
            _, physical, present = columns[status.index]
            good = np.isin(physical, status.values)
            if present is not None:
                good &= present
            codes[(codes == 0) & ~good] = STATUS
        if self.third is not None:
            values[:, -1] = self.third
        return (values[:, 0] if values.shape[1] == 1 else values), codes


def arrays_of(taps: Sequence[Tap], columns: Columns) -> TapColumns:
    """What each tap takes of decoded columns."""
    return [tap.array(columns) for tap in taps]
