"""Routes: one message (or one raw expression) and the quantities that it carries."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.can.columns import FrameColumns, IdMatch
from imucald.can.dbc.decode import DecodePlan
from imucald.can.e2e.protection import REASONS, MessageChecker
from imucald.core.samples import GRAVITY
from imucald.inputs.conversion import STATUS, Conversion
from imucald.inputs.expression import Expression
from imucald.inputs.rate_guard import JudgesRate, RateGuard

ABSENT = -1
"""Code of a value that the frame does not carry (another multiplexer value)."""

PLANAR_Z = GRAVITY
"""What a planar accelerometer's missing z axis is taken as [m/s^2]: it is level by declaration."""

Raw = Sequence[int | float | None]
Physical = Sequence[float | None]
Columns = Sequence[tuple[NDArray[np.generic], NDArray[np.float64], NDArray[np.bool_] | None]]
"""Raw values, physical values and presence (None: always) of each signal."""


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


class SignalRoute(Protocol):
    """How frames of one kind become numbers."""

    @property
    def name(self) -> str:
        """Name for people."""

    @property
    def match(self) -> IdMatch:
        """Which frames."""

    @property
    def taps(self) -> tuple[Tap, ...]:
        """What they carry."""

    @property
    def guard(self) -> JudgesRate:
        """How often they may come."""

    @property
    def stated_cycle(self) -> float | None:
        """Their cycle [s] as the configuration or the database states it."""

    def check(self, t: float, data: bytes) -> str | None:
        """Judge a frame at stream time t [s]: "" good, None not of this kind, else the reason."""

    def numbers(self, data: bytes) -> tuple[Raw, Physical]:
        """Raw and physical values of a good frame."""

    def check_columns(
        self, t: NDArray[np.float64], frames: FrameColumns
    ) -> tuple[NDArray[np.bool_], Mapping[str, NDArray[np.int64]]]:
        """Good frames (N,), and the rows of bad ones by reason."""

    def number_columns(self, frames: FrameColumns) -> Columns:
        """Raw and physical values of good frames, one entry a signal."""


class MessageRoute:
    """Frames that a database describes."""

    def __init__(self, plan: DecodePlan, checker: MessageChecker, taps: Sequence[Tap]) -> None:
        self.name = plan.message.name
        self.match = plan.id_match
        self.plan = plan
        self.checker = checker
        self.taps = tuple(sorted(taps, key=lambda tap: tap.rank))
        self.stated_cycle = checker.spec.cycle_time or plan.message.cycle_time
        self.guard = RateGuard(self.stated_cycle, checker.spec.counter is not None)

    def check(self, t: float, data: bytes) -> str | None:
        """Length, checksum, counter, time-out."""
        return self.checker.check(t, data) or ""

    def numbers(self, data: bytes) -> tuple[Raw, Physical]:
        """Decode one frame."""
        raw = self.plan.decode_raw(data)
        return raw, self.plan.scale(raw)

    def check_columns(
        self, t: NDArray[np.float64], frames: FrameColumns
    ) -> tuple[NDArray[np.bool_], Mapping[str, NDArray[np.int64]]]:
        """`check` on columns."""
        codes = self.checker.check_columns(t, frames.data, frames.length)
        ok = codes == 0
        if ok.all():
            return ok, {}
        return ok, {
            REASONS[code]: np.flatnonzero(codes == code) for code in np.unique(codes[~ok]).tolist()
        }

    def number_columns(self, frames: FrameColumns) -> Columns:
        """Decode columns."""
        found = self.plan.decode_columns(frames.data, frames.length)
        return list(zip(found.raw, found.values, found.present, strict=True))


class RawRoute:
    """Frames that a configured expression describes."""

    def __init__(
        self, name: str, match: IdMatch, when: Expression | None, value: Expression, tap: Tap
    ) -> None:
        self.name = name
        self.match = match
        self.taps = (tap,)
        self.stated_cycle: float | None = None
        self.guard = RateGuard()
        self._when = when
        self._value = value

    def check(self, t: float, data: bytes) -> str | None:
        """The condition, and the length the value needs."""
        if self._when is not None and not (
            len(data) >= self._when.needs and self._when.holds(data)
        ):
            return None
        return "" if len(data) >= self._value.needs else "short_frame"

    def numbers(self, data: bytes) -> tuple[Raw, Physical]:
        """The value; raw and physical are one."""
        number = self._value.number(data)
        return (number,), (number if math.isfinite(number) else math.nan,)

    def check_columns(
        self, t: NDArray[np.float64], frames: FrameColumns
    ) -> tuple[NDArray[np.bool_], Mapping[str, NDArray[np.int64]]]:
        """`check` on columns."""
        ours = np.ones(len(frames), dtype=bool)
        if self._when is not None:
            ours = (frames.length >= self._when.needs) & self._when.hold(frames.data, frames.length)
        short = ours & (frames.length < self._value.needs)
        reasons = {"short_frame": np.flatnonzero(short)} if short.any() else {}
        return ours & ~short, reasons

    def number_columns(self, frames: FrameColumns) -> Columns:
        """The values."""
        numbers = self._value.numbers(frames.data, frames.length)
        return [(numbers, numbers, None)]
