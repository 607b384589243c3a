"""All signals of the databases that occur in a recording, as numbers on a common time grid."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from imucald.can.columns import CAN_EFF_FLAG, CAN_EFF_MASK, FrameColumns, IdMatch
from imucald.can.dbc.database import Database
from imucald.can.dbc.decode import J1939_ADDRESS_MASK, compile_decode, id_match
from imucald.can.dbc.message import Message, Signal
from imucald.can.dbc.resolved_signal import raw_limits
from imucald.config_check.motion import bridged, smooth
from imucald.core.arrays import Array
from imucald.core.errors import DatabaseError
from imucald.discovery.evidence import factor_of
from imucald.discovery.recording import Traffic
from imucald.inputs.sender_choice import SenderChoice
from imucald.inputs.settings_of_signals import no_values
from imucald.inputs.sign_bit import SignBit
from imucald.inputs.units import is_unit
from imucald.motion.ticks import TICK_RATE

FEW_LEVELS = 16
"""Largest number of different values of a signal that may be a switch or a gear lever."""
MEASURED_BITS = 7
"""Smallest length of a signal that measures an acceleration, a rate or a speed [bits]."""
MIN_FRAMES = 20
"""Smallest number of frames of a message that is used."""
SNA_BITS = 6
"""Smallest signal length [bits] at which an outlier with all bits set probably means 'not
available'."""
SMALL_AT_SIGN = 0.3
"""Largest size of a magnitude when its sign bit changes, relative to the mean size of the
magnitude. If the bit is not the sign bit, the size at a change is about the mean size."""
WRAPPED, JOINED = 0.9, 0.5
"""Sizes of a step, relative to the range of the raw value. If a signed number is read as unsigned,
a change of its sign is a step of nearly the whole range. If the number is read as signed, the same
step is smaller than half of the range."""
CODES = 8
"""Largest number of raw values at the upper end of the range that may be codes ('not available',
'error')."""
_NO_UNIT = frozenset({"", "-", "1", "none", "unit", "raw", "bit", "bits", "unitless"})


@dataclass(frozen=True, eq=False)
class SeenSignal:
    """One signal of a recording. x, smooth: (n,) values at ticks of 0.1 s in the signal's unit, NaN
    if unknown.

    cycle: mean time between frames [s]. levels: the different values of a signal with at most
    FEW_LEVELS values; empty for other signals. held: (n,) last value before the end of each tick,
    for signals with few values. unavailable: raw values that mean 'not available' according to the
    data, although no value table contains them.
    """

    message: Message
    signal: Signal
    channel: str
    x: Array
    smooth: Array
    cycle: float
    levels: tuple[float, ...]
    held: Array | None
    unavailable: tuple[int, ...]
    least: float
    largest: float
    course: Array | None = None
    """The values [rad] without jumps by a full turn, of a signal in a unit of angle."""
    raw: Mapping[str, Any] | None = None
    """Bytes and expression of a signal that no database describes."""
    sign_signal: str | None = None
    """``MESSAGE.SIGNAL`` of the sign bit, for a signal whose sign is in another signal."""
    source_address: int | None = None
    """Source address of the sender if several control units send this J1939 message."""
    own_channel: str | None = None
    """Channel to state in a raw source if the recording has several channels."""

    @property
    def path(self) -> str:
        """Name of the signal as ``MESSAGE.SIGNAL``."""
        return f"{self.message.name}.{self.signal.name}"

    @property
    def unit(self) -> str:
        """The unit in the database."""
        return self.signal.unit.strip()

    @property
    def has_no_unit(self) -> bool:
        """True if the database states no unit."""
        return self.unit.casefold() in _NO_UNIT

    @property
    def is_constant(self) -> bool:
        """True if the signal never changed."""
        return self.least == self.largest

    @property
    def is_magnitude(self) -> bool:
        """True if the sign of the signal may be in another signal."""
        is_signed = self.signal.is_signed or self.signal.is_float or self.least < 0.0
        return not (is_signed or self.levels or self.raw)

    @property
    def is_bit(self) -> bool:
        """True if the signal may be a sign bit."""
        return self.signal.length == 1 and len(self.levels) == 2

    @property
    def is_switch(self) -> bool:
        """True if the signal had only two values and has no unit (on or off)."""
        return 0 < len(self.levels) <= 2 and self.has_no_unit

    def may_be(self, dimension: str) -> bool:
        """True if the signal may have this dimension: its unit has this dimension, or the unit is
        unknown."""
        return self.has_no_unit or self.states(dimension) or not is_unit(self.unit)

    def states(self, dimension: str) -> bool:
        """True if the unit of the signal has this dimension."""
        return not self.has_no_unit and factor_of(self.unit, dimension) is not None


@dataclass(frozen=True, eq=False)
class MessageTraffic:
    """A message of a database with its frames.

    senders: source addresses if several control units send this J1939 message. The frames are the
    frames of the first address.
    """

    message: Message
    channel: str
    t: Array
    data: NDArray[np.uint8]
    length: NDArray[np.uint8]
    senders: tuple[int, ...] = ()


def stated_cycles(databases: Mapping[str, Database]) -> Iterator[tuple[IdMatch, float]]:
    """Yield the messages with a stated cycle time [s]."""
    for database in databases.values():
        for message in database.messages.values():
            if message.cycle_time:
                yield id_match(message), message.cycle_time


def readable_messages(database: Database) -> Iterator[tuple[Message, IdMatch]]:
    """Yield each message with signals that can be decoded, and the identifiers of its frames."""
    for message in database.messages.values():
        if message.unsupported or not message.signals:
            continue
        try:
            yield message, id_match(message)
        except DatabaseError:
            continue


def compared_by_pgn(database: Database, traffic: Sequence[Traffic]) -> Database | None:
    """Return the database read as J1939 if its 29-bit identifiers match the traffic only in this
    way; else None.

    Many J1939 databases do not state that they are J1939. The frames then have another source
    address or priority than the database states.
    """
    here = [m for m, _ in readable_messages(database) if m.can_id & CAN_EFF_FLAG]

    def come(j1939: bool | None) -> bool:
        matches = [id_match(message, j1939) for message in here]
        return any(m.matches(one.can_id, one.channel) for m in matches for one in traffic)

    if come(None) or not come(True):
        return None
    messages = database.messages.values()
    is_29_bit = (bool(m.can_id & CAN_EFF_FLAG) for m in messages)
    changed = zip(messages, is_29_bit, strict=True)
    return Database([structs.replace(m, is_j1939=m.is_j1939 or e) for m, e in changed], {})


def messages_in(
    database: Database, traffic: Sequence[Traffic], channel: str | None
) -> Iterator[MessageTraffic]:
    """Yield each decodable message on a channel (None: any channel), with its frames."""
    for message, match in readable_messages(database):
        parts = [
            one
            for one in traffic
            if match.matches(one.can_id, one.channel) and channel in (None, one.channel)
        ]
        if not parts:
            continue
        first = parts[0].channel
        parts = [
            p for p in parts if p.channel == first and p.data.shape[1] == parts[0].data.shape[1]
        ]
        t = np.concatenate([p.t for p in parts])
        order = np.argsort(t, kind="stable")
        frames = FrameColumns(
            t[order],
            np.concatenate([np.full(len(p), p.can_id, np.uint32) for p in parts])[order],
            np.concatenate([p.length for p in parts])[order],
            np.concatenate([p.data for p in parts])[order],
            np.zeros(len(t), np.uint8),
            (first,),
        )
        senders: tuple[int, ...] = ()
        if not match.mask & J1939_ADDRESS_MASK:
            address = frames.can_id & np.uint32(J1939_ADDRESS_MASK)
            found, counts = np.unique(address, return_counts=True)
            often: list[int] = found[counts >= MIN_FRAMES].tolist()
            if len(often) > 1:
                chosen = _chosen_sender(frames, often)
                senders = (chosen, *(other for other in often if other != chosen))
                frames = frames.take(address == chosen)
        yield MessageTraffic(message, first, frames.t, frames.data, frames.length, senders)


def _chosen_sender(frames: FrameColumns, often: Sequence[int]) -> int:
    """Return the sender of a J1939 message that `run` chooses, or else the first of those that sent
    often enough."""
    choice = SenderChoice()
    for t, can_id, data in frames.rows():
        if choice.is_settled(t):
            break
        choice.takes(t, can_id, data)
    found = choice.address
    return found if found is not None and found in often else often[0]


def candidates_of(one: MessageTraffic, ticks: int) -> Iterator[SeenSignal]:
    """Yield every signal of a message that can be decoded and was received often enough."""
    names = []
    for name in one.message.signals:
        try:
            compile_decode(one.message, [name])
        except DatabaseError:
            continue
        names.append(name)
    if not names:
        return
    plan = compile_decode(one.message, names, may_be_cut=True)
    decoded = plan.decode_columns(one.data, one.length)
    for i, name in enumerate(names):
        good, present = decoded.ok.copy(), decoded.present[i]
        if present is not None:
            good &= present
        found = _candidate(one, name, decoded.raw[i], decoded.values[i], good, ticks)
        if found is not None:
            yield found


def with_sign_bits(
    messages: Mapping[str, MessageTraffic], found: Sequence[SeenSignal], ticks: int
) -> Iterator[SeenSignal]:
    """Yield magnitudes, each with its best sign bit; a bit of the same message comes first.

    The values are those that a configuration with this bit as `sign_signal` would give.
    """
    own = [c for c in found if c.message.name in messages]
    bits = []
    for bit in (c for c in own if c.is_bit):
        t, state, _, _ = _decoded(messages[bit.message.name], bit)
        changed = t[1:][state[1:] != state[:-1]]
        if len(changed) >= MIN_FRAMES:
            bits.append((bit, t, state, changed))
    for c in own:
        if not c.is_magnitude:
            continue
        one = messages[c.message.name]
        t, values, raw, rows = _decoded(one, c)
        small = SMALL_AT_SIGN * float(np.abs(values).mean())
        best: tuple[tuple[bool, float], SeenSignal, Array] | None = None
        for bit, t_bit, state, changed in bits:
            at = np.minimum(t.searchsorted(changed), len(t) - 1)
            if not np.abs(values[at]).mean() < small:
                continue
            sign = SignBit(bit.path)
            sign.expect(bit.message.cycle_time)
            order = np.arange(len(t_bit))
            sign.see_columns(t_bit, order, state)
            factors = sign.at_columns(t, t_bit.searchsorted(t, "right") - 1)
            known = np.isfinite(factors)
            size = _size_at_sign((values * factors)[known])
            rank = bit.message.name != c.message.name, size
            if size < SMALL_AT_SIGN and (best is None or rank < best[0]):
                best = rank, bit, factors
        if best is not None:
            _, bit, factors = best
            good = np.zeros(len(one.t), np.bool_)
            good[rows] = np.isfinite(factors)
            every = np.zeros(len(one.t))
            every[rows] = values * np.nan_to_num(factors)
            again = _candidate(one, c.signal.name, raw, every, good, ticks)
            if again is not None:
                yield replace(again, sign_signal=bit.path)


def _decoded(
    one: MessageTraffic, c: SeenSignal
) -> tuple[Array, Array, NDArray[np.generic], NDArray[np.intp]]:
    """Return times and values (N,) of the frames in which a signal has a value, the raw numbers of
    all frames, and the indices (N,) of the frames with a value.
    """
    found = compile_decode(one.message, [c.signal.name], may_be_cut=True).decode_columns(
        one.data, one.length
    )
    good = found.ok & ~np.isin(found.raw[0], c.unavailable)
    if found.present[0] is not None:
        good &= found.present[0]
    rows = np.flatnonzero(good)
    return one.t[rows], found.values[0][rows], found.raw[0], rows


def _size_at_sign(values: Array) -> float:
    """Return the mean magnitude of values at changes of sign, relative to their mean magnitude."""
    at = np.flatnonzero(np.signbit(values[1:]) != np.signbit(values[:-1]))
    usual = float(np.abs(values).mean()) if len(values) else 0.0
    return float(np.abs(values[at]).mean()) / usual if len(at) and usual else math.inf


def _candidate(
    one: MessageTraffic,
    name: str,
    raw: NDArray[np.generic],
    values: Array,
    good: NDArray[np.bool_],
    ticks: int,
) -> SeenSignal | None:
    signal = one.message.signal(name)
    if misses_sign(signal, raw[good]):
        return None
    named = list(no_values(signal.choices))
    if isinstance(signal.invalid_raw, int):
        named.append(signal.invalid_raw)
    good &= np.isfinite(values) & ~np.isin(raw, named)
    unavailable = () if signal.is_float else _unavailable(signal, raw[good])
    good &= ~np.isin(raw, unavailable)
    if np.count_nonzero(good) < MIN_FRAMES:
        return None
    t, values = one.t[good], values[good]
    index = np.minimum((t * TICK_RATE).astype(np.int64), ticks - 1)
    count = np.bincount(index, minlength=ticks)
    rows = np.flatnonzero(count)

    def means(of: Array) -> Array:
        return bridged(ticks, rows, np.bincount(index, of, minlength=ticks)[rows] / count[rows])

    x, radians = means(values), factor_of(signal.unit, "angle")
    levels = np.unique(values[:200_000])
    few = len(levels) <= FEW_LEVELS
    return SeenSignal(
        message=one.message,
        signal=signal,
        channel=one.channel,
        x=x,
        smooth=smooth(x),
        cycle=float(t[-1] - t[0]) / (len(t) - 1),
        levels=tuple(levels.tolist()) if few else (),
        held=_held(t, values, ticks) if few else None,
        unavailable=unavailable,
        least=float(values.min()),
        largest=float(values.max()),
        course=None if radians is None else means(np.unwrap(values * radians)),
        source_address=one.senders[0] if one.senders else None,
    )


def _held(t: Array, values: Array, ticks: int) -> Array:
    """Return the last value before the end of each tick; NaN before the first value."""
    last = np.searchsorted(t, (np.arange(ticks) + 1.0) / TICK_RATE) - 1
    return np.where(last >= 0, values[np.maximum(last, 0)], np.nan)


def _unavailable(signal: Signal, raw: NDArray[np.generic]) -> tuple[int, ...]:
    """Return the raw values that mean 'not available': the value with all bits set, or the lowest
    signed number.

    The step to such a value must be at least twice any other step. A true signal reaches the end of
    its range with its usual steps.
    """
    if signal.length < SNA_BITS or len(raw) < MIN_FRAMES:
        return ()
    low, high = raw_limits(signal)
    found = []
    for code in (high, low) if signal.is_signed else (high,):
        here = raw == code
        if not here.any() or here.mean() > 0.5:
            continue
        others = raw[~here].astype(np.float64)
        if len(others) < MIN_FRAMES:
            continue
        usual = float(np.abs(np.diff(others)).max(initial=0.0))
        if float(np.abs(others - code).min()) > max(2.0 * usual, 0.1 * (high - low)):
            found.append(int(code))
    return tuple(found)


def misses_sign(signal: Signal, raw: NDArray[np.generic]) -> bool:
    """True if a signal is signed according to its values (n,) but unsigned in the database."""
    if signal.is_signed or signal.is_float or signal.length < SNA_BITS:
        return False
    size = float(2**signal.length)
    values = raw.astype(np.float64)
    if len(np.unique(values[values >= WRAPPED * size])) <= CODES:
        return False
    joined = np.where(values >= 0.5 * size, values - size, values)
    steps = (float(np.abs(np.diff(x)).max(initial=0.0)) for x in (values, joined))
    return next(steps) > WRAPPED * size and next(steps) < JOINED * size


def silent_candidates(database: Database) -> Iterator[SeenSignal]:
    """Yield every signal of a database without a recording. Only the name and the unit are then
    known."""
    nothing = np.full(1, np.nan)
    for message in database.messages.values():
        for signal in message.signals.values() if not message.unsupported else ():
            low, high = (
                raw * signal.scale + signal.offset
                for raw in ((0.0, 1.0) if signal.is_float else raw_limits(signal))
            )
            cycle = message.cycle_time or 1.0
            levels = (low, high) if signal.length == 1 else ()
            yield SeenSignal(
                message, signal, "", nothing, nothing, cycle, levels, None, (), low, high
            )


def obd_speeds(traffic: Sequence[Traffic], ticks: int) -> Iterator[SeenSignal]:
    """Yield the speeds in answers to OBD-II requests (SAE J1979: mode 01, PID 0x0D, km/h)."""
    several = len({one.channel for one in traffic}) > 1
    for one in traffic:
        if not _is_obd_answer(one.can_id) or one.data.shape[1] < 4:
            continue
        rows = (one.data[:, 1] == 0x41) & (one.data[:, 2] == 0x0D) & (one.length >= 4)
        if np.count_nonzero(rows) < MIN_FRAMES:
            continue
        signal = Signal("vehicle_speed_PID_0x0D", 24, 8, unit="km/h")
        message = Message("OBD-II", one.can_id, 4, {signal.name: signal})
        answers = MessageTraffic(
            message, one.channel, one.t[rows], one.data[rows], one.length[rows]
        )
        raw = {
            "id": one.can_id & CAN_EFF_MASK,
            "when": "data[1] == 0x41 and data[2] == 0x0D",
            "value": "data[3]",
        }
        for candidate in candidates_of(answers, ticks):
            yield replace(candidate, raw=raw, own_channel=one.channel if several else None)


def _is_obd_answer(can_id: int) -> bool:
    """True if an identifier is for answers according to ISO 15765-4."""
    return 0x7E8 <= can_id <= 0x7EF or can_id & ~0xFF == 0x98DAF100


def words(name: str) -> list[str]:
    """Return the parts of a name in lower case: "WheelSpeed_FL" gives wheel, speed, fl."""
    parted = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", name)
    return [w.lower() for w in re.split(r"[\W_]+|(?<=\D)(?=\d)|\s+", parted) if w]
