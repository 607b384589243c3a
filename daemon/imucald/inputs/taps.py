"""Taps. A tap is the set of values that one message or raw expression contains for one channel.

A channel is a measured quantity (`core.samples`: "accel", "speed", ...), not a CAN bus.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.core.samples import GRAVITY
from imucald.inputs.conversion import STATUS, Conversion

ABSENT = -1
"""Code of a value that is not in the frame (because of the multiplexer)."""

PLANAR_Z = GRAVITY
"""The assumed z value of an accelerometer with two axes [m/s^2]. The configuration states that this
sensor is mounted level."""

Raw = Sequence[int | float | None]
Physical = Sequence[float | None]
Columns = Sequence[tuple[NDArray[np.generic], NDArray[np.float64], NDArray[np.bool_] | None]]
"""Raw values, physical values and presence (None: always present) of each signal."""


class Component(Struct, frozen=True):
    """One number of a tap. index: index in the signals of the route. conversion: conversion to
    SI."""

    index: int
    conversion: Conversion


class Status(Struct, frozen=True):
    """A signal of the same message that states whether the values can be used.

    index: index in the route's signals. values: physical values that mean "can be used".
    """

    index: int
    values: tuple[float, ...]


class Tap(Struct, frozen=True):
    """The values of a route for one channel (quantity).

    slots: indices in the channel's values, in the order of components. complete: whether the tap
    contains all values of the channel. third: assumed third value of a two-axis sensor; None if it
    has three axes. rank: 0 is the preferred source. statuses: status signals; all of them must
    state that the values can be used.
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
        """A key of all settings that determine the tap's values. Settings of checks are not in the
        key."""
        return self.channel, self.rank, self.slots, self.third

    def scalar(self, raw: Raw, physical: Physical) -> tuple[Sequence[float], int]:
        """Return values in SI and code (see `conversion.REASONS`) for the numbers of one frame."""
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
        """Return values (N,) or (N, k) in SI and codes (N,). If several values of a row have a
        fault, the first fault determines the code."""
        n = len(columns[self.components[0].index][1])
        codes = np.zeros(n, dtype=np.int8)
        values = np.empty((len(self.components) + (self.third is not None), n))
        for i, component in enumerate(self.components):
            raw, physical, present = columns[component.index]
            values[i], found = component.conversion.array(raw, physical)
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
            values[-1] = self.third
        return (values[0] if len(values) == 1 else values.T), codes
