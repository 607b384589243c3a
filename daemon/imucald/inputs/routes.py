"""Routes. A route converts the frames of one message (or one raw expression) to quantities."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucald.can.columns import CAN_EFF_FLAG, IdMatch
from imucald.can.dbc.bits import Columns as Bytes
from imucald.can.dbc.decode import J1939_ADDRESS_MASK, DecodePlan
from imucald.can.e2e.protection import OK, SHORT, MessageChecker
from imucald.inputs.rate_guard import RateGuard
from imucald.inputs.sender_choice import SenderChoice
from imucald.inputs.sign_bit import SignBit
from imucald.inputs.taps import Columns, Physical, Raw, Tap

if TYPE_CHECKING:
    from imucald.inputs.expression import Expression

NOT_OURS = 255
"""Code of a frame that is not for the route, next to the codes of `can.e2e.protection`."""

SENSORS = frozenset({"accel", "gyro", "mag", "parallel"})
"""Channels of mounted sensors. The sensors of two senders have different mounts."""


def is_of_any_sender(match: IdMatch) -> bool:
    """True if frames with different J1939 source addresses match."""
    return bool(match.can_id & CAN_EFF_FLAG) and not match.mask & J1939_ADDRESS_MASK


class MessageRoute:
    """The route of a message in a database.

    signs: signs of signals that are magnitudes. The key is the index of the signal in the plan. The
    value is the index of its sign signal in this message, or a `SignBit` of another message. A sign
    signal is not 0 if the value is negative. given: sign signals of this message for magnitudes in
    other messages, by index.
    """

    def __init__(
        self,
        plan: DecodePlan,
        checker: MessageChecker,
        taps: Sequence[Tap],
        signs: Mapping[int, int | SignBit] = MappingProxyType({}),
        given: Mapping[int, SignBit] = MappingProxyType({}),
    ) -> None:
        self.name = plan.message.name
        self.match = plan.id_match
        self.plan = plan
        self.checker = checker
        self.taps = tuple(sorted(taps, key=lambda tap: tap.rank))
        self.stated_cycle = checker.spec.cycle_time or plan.message.cycle_time
        self.guard = RateGuard(self.stated_cycle, checker.spec.counter is not None)
        self.signs, self.given = dict(signs), dict(given)
        for bit in self.given.values():
            bit.expect(self.stated_cycle)
        is_sensor = any(tap.channel.partition("/")[0] in SENSORS for tap in self.taps)
        self.sender = SenderChoice() if is_sensor and is_of_any_sender(self.match) else None

    @property
    def takes_signs(self) -> bool:
        """True if the signs of some values are in other messages."""
        return any(isinstance(sign, SignBit) for sign in self.signs.values())

    @property
    def frame_key(self) -> Hashable:
        """The message and its identifiers."""
        return self.name, self.match

    def source_of(self, tap: Tap) -> Hashable:
        """Return a key of all settings that determine a tap's values: identifiers, bits,
        multiplexers, scaling and conversion."""
        found = []
        for component in tap.components:
            signal = self.plan.signals[component.index]
            selectors = [(self.plan.multiplexers[name].field, i) for name, i in signal.selectors]
            kind = signal.signal.is_signed, signal.signal.is_float
            sign = self.signs.get(component.index)
            bit = self.plan.signals[sign].field if isinstance(sign, int) else sign and sign.source
            number = signal.field, kind, signal.scaling, tuple(selectors), bit
            found.append((number, component.conversion.source))
        return self.match, tap.source, tuple(found)

    def go_on_from(self, former: SignalRoute) -> None:
        """Continue with the former route's state (counter, distrust, usual rate) if the protection
        is the same."""
        if not isinstance(former, MessageRoute):
            return
        spec, before = self.checker.spec, former.checker.spec
        if spec == before:
            self.checker = former.checker
        is_like = (spec.counter is None) == (before.counter is None)
        if is_like and self.stated_cycle == former.stated_cycle:
            self.guard = former.guard
        if self.sender is not None and former.sender is not None:
            self.sender = former.sender
        known = {bit.source: bit for bit in former.given.values()}
        for bit in self.given.values():
            if bit.source in known:
                bit.go_on_from(known[bit.source])

    def check(self, t: float, data: bytes) -> str | None:
        """Check length, checksum, counter and time-out."""
        return self.checker.check(t, data) or ""

    def numbers(self, t: float, data: bytes) -> tuple[Raw, Physical]:
        """Decode one frame at stream time t [s]."""
        raw = self.plan.decode_raw(data)
        physical = self.plan.scale(raw)
        for index, given in self.given.items():
            if (bit := raw[index]) is not None:
                given.see(t, bit)
        return raw, self._signed(t, raw, physical) if self.signs else physical

    def _signed(self, t: float, raw: Raw, physical: Physical) -> Physical:
        found = list(physical)
        for index, sign in self.signs.items():
            value = found[index]
            if isinstance(sign, SignBit):
                found[index] = None if value is None else value * sign.at(t)
                continue
            bit = raw[sign]
            found[index] = None if value is None or bit is None else -value if bit else value
        return found

    def check_columns(
        self, t: NDArray[np.float64], data: Bytes, length: NDArray[np.uint8]
    ) -> NDArray[np.uint8]:
        """Do the work of `check` for payloads (N, W) with lengths (N,). Return the codes (N,)."""
        return self.checker.check_columns(t, data, length)

    def number_columns(
        self,
        t: NDArray[np.float64],
        row: NDArray[np.int64],
        data: Bytes,
        length: NDArray[np.uint8],
    ) -> Columns:
        """Decode columns. row: (N,) rows of the frames in their chunk."""
        found = self.plan.decode_columns(data, length)
        columns = list(zip(found.raw, found.values, found.present, strict=True))
        for index, given in self.given.items():
            bit, _, known = columns[index]
            there = slice(None) if known is None else known
            given.see_columns(t[there], row[there], bit[there])
        for index, sign in self.signs.items():
            raw, values, present = columns[index]
            if isinstance(sign, SignBit):
                columns[index] = raw, values * sign.at_columns(t, row), present
                continue
            bit, _, known = columns[sign]
            if known is not None:
                present = known if present is None else known & present
            columns[index] = raw, np.where(bit != 0, -values, values), present
        return columns


class RawRoute:
    """The route of a configured raw expression."""

    def __init__(
        self,
        name: str,
        match: IdMatch,
        when: Expression | None,
        value: Expression,
        tap: Tap,
        message: str = "",
        checker: MessageChecker | None = None,
    ) -> None:
        self.name = name
        self.match = match
        self.taps = (tap,)
        self.message, self.checker = message, checker
        self.sender = None
        self.stated_cycle: float | None = None
        self.guard = RateGuard()
        self._when = when
        self._value = value

    @property
    def frame_key(self) -> Hashable:
        """Key of identifiers and condition."""
        return self.match, None if self._when is None else self._when.text

    def source_of(self, tap: Tap) -> Hashable:
        """Return a key of the identifiers, the expressions and the conversion."""
        conversions = tuple(component.conversion.source for component in tap.components)
        return self.frame_key, self._value.text, tap.source, conversions

    def go_on_from(self, former: SignalRoute) -> None:
        """Continue with the former route's usual rate. If the protection is the same, also continue
        with its counter and distrust."""
        self.guard = former.guard
        if not isinstance(former, RawRoute) or self.checker is None or former.checker is None:
            return
        if self.checker.spec == former.checker.spec:
            self.checker = former.checker

    def check(self, t: float, data: bytes) -> str | None:
        """Check the protection of the message, the condition, and the length that the value needs.
        Every frame of the message is used for the check of the protection."""
        reason = None if self.checker is None else self.checker.check(t, data)
        if self._when is not None and not (
            len(data) >= self._when.needs and self._when.holds(data)
        ):
            return None
        return reason or ("" if len(data) >= self._value.needs else "short_frame")

    def numbers(self, t: float, data: bytes) -> tuple[Raw, Physical]:
        """Return the value of the expression as raw value and as physical value; both are equal."""
        number = self._value.number(data)
        return (number,), (number if math.isfinite(number) else math.nan,)

    def check_columns(
        self, t: NDArray[np.float64], data: Bytes, length: NDArray[np.uint8]
    ) -> NDArray[np.uint8]:
        """Do the work of `check` for payloads (N, W) with lengths (N,). Return the codes (N,)."""
        codes = np.zeros(len(t), np.uint8)
        if self.checker is not None:
            codes = self.checker.check_columns(t, data, length)
        codes[(codes == OK) & (length < self._value.needs)] = SHORT
        if self._when is not None:
            codes[~((length >= self._when.needs) & self._when.hold(data, length))] = NOT_OURS
        return codes

    def number_columns(
        self,
        t: NDArray[np.float64],
        row: NDArray[np.int64],
        data: Bytes,
        length: NDArray[np.uint8],
    ) -> Columns:
        """Return the values."""
        numbers = self._value.numbers(data, length)
        return [(numbers, numbers, None)]


SignalRoute = MessageRoute | RawRoute
"""A route for a message or for a raw expression. Both classes have the same attributes and
methods."""
