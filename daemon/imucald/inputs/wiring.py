"""Build a `Router` from configuration and databases. Mistakes raise ConfigError with the line."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Sequence
from typing import TypeVar

from msgspec import Struct, field, structs

from imucald import config as cfg
from imucald.can.columns import CAN_EFF_FLAG, CAN_EFF_MASK, CAN_SFF_MASK, IdMatch
from imucald.can.dbc.bits import field_of
from imucald.can.dbc.database import Database, load_database
from imucald.can.dbc.decode import compile_decode, id_match
from imucald.can.dbc.message import Message, Signal
from imucald.can.dbc.resolved_signal import raw_limits
from imucald.can.e2e.checksums import KINDS, NO_CHECKSUM, ONE_BYTE_KINDS
from imucald.can.e2e.protection import MessageChecker
from imucald.config import LoadedConfig
from imucald.core.errors import ConfigError, DatabaseError
from imucald.inputs.conversion import Conversion
from imucald.inputs.quantities import Place, Wanted, wanted_numbers
from imucald.inputs.router import Router
from imucald.inputs.routes import SENSORS, MessageRoute, RawRoute, SignalRoute, is_of_any_sender
from imucald.inputs.settings_of_signals import as_decoded, check_raw, checker_for, no_values
from imucald.inputs.sign_bit import SignBit
from imucald.inputs.taps import PLANAR_Z, Component, Status, Tap
from imucald.inputs.units import Unit, find_unit, unit_names

Number = TypeVar("Number", int, float)

SPLIT_PLANAR = "x and y of a sensor without z must be in one message, in one frame"
_SENSORS = ("accel", "gyro")
"""Channels in which values at the end of the range mean a saturated sensor."""


class LoadedDatabase(Struct):
    """A database of the configuration and its messages."""

    entry: cfg.DatabaseSettings
    database: Database
    place: Place


class _MessageSignals(Struct):
    """The requested signals of one message. signs: see `MessageRoute`."""

    message: Message
    channel: str | None
    j1939: bool | None
    source_address: int | None = None
    names: list[str] = field(default_factory=list)
    signs: dict[int, int | SignBit] = field(default_factory=dict)
    given: dict[int, SignBit] = field(default_factory=dict)
    wanted: list[tuple[Wanted, int, Conversion]] = field(default_factory=list)
    statuses: dict[tuple[str, int], list[Status]] = field(default_factory=dict)


Groups = dict[tuple[str, str | None, int | None], _MessageSignals]
"""Requested signals, by message, channel of a recording, and sender."""


def load_databases(loaded: LoadedConfig) -> list[LoadedDatabase]:
    """Read the databases of the configuration. For an unreadable database, raises ConfigError with
    the line in the configuration."""
    found = []
    for i, entry in enumerate(loaded.config.database):
        place: Place = ("database", i)
        path = loaded.database_path(entry)
        try:
            database = load_database(path)
        except DatabaseError as error:
            is_there = os.path.exists(path)  # noqa: PTH110 - False too of a name no file can have
            remedy = "" if is_there else "; paths are relative to the configuration file"
            raise loaded.error(place, f"{error}{remedy}") from None
        found.append(LoadedDatabase(entry, database, place))
    return found


def compile_router(loaded: LoadedConfig) -> Router:
    """Build the router that a configuration describes.

    Raises ConfigError with line and remedy if a message, a signal or a unit does not fit.
    """
    databases = load_databases(loaded)
    groups: Groups = {}
    routes: list[SignalRoute] = []
    for wanted in wanted_numbers(loaded.config.signals):
        if wanted.source.raw is not None:
            routes.append(_raw_route(loaded, databases, wanted, wanted.source.raw))
        else:
            _add_signal(loaded, databases, groups, wanted)
    raw_names = {r.message for r in routes if isinstance(r, RawRoute) and r.message}
    _refuse_unknown_messages(loaded, raw_names | {group.message.name for group in groups.values()})
    _refuse_unknown_checksums(loaded)
    _refuse_split_planar(loaded, groups.values())
    ordered = sorted(groups.values(), key=lambda group: not group.given)
    routes += [_message_route(loaded, group) for group in ordered]
    signals = loaded.config.signals
    return Router(
        routes,
        derive_speed=signals.speed is None and signals.wheel_speeds is not None,
        derive_reverse=signals.reverse is None and _signed_speed(groups.values()),
    )


def _signed_speed(groups: Iterable[_MessageSignals]) -> bool:
    """True if a speed signal can be negative. In this case its sign is used as the reverse
    signal."""
    return any(
        w.channel == "speed" and (g.message.signal(g.names[i]).is_signed or i in g.signs)
        for g in groups
        for w, i, _ in g.wanted
    )


def _add_signal(
    loaded: LoadedConfig,
    databases: Sequence[LoadedDatabase],
    groups: Groups,
    wanted: Wanted,
) -> None:
    path = wanted.source.signal or ""
    group, signal = _grouped(loaded, databases, groups, wanted, path)
    sign = None
    if wanted.source.sign_signal is not None:
        sign = _sign_of(loaded, databases, groups, wanted, group, signal)
    index = _signed_index(group, signal, sign)
    conversion = _conversion(loaded, wanted, signal)
    group.wanted.append((wanted, index, conversion))
    if wanted.source.valid_when is not None:
        _add_status(loaded, group, wanted, wanted.source.valid_when)


def _grouped(
    loaded: LoadedConfig,
    databases: Sequence[LoadedDatabase],
    groups: Groups,
    wanted: Wanted,
    path: str,
) -> tuple[_MessageSignals, Signal]:
    holder, message, signal = _find(loaded, databases, wanted, path)
    channel = wanted.source.channel or holder.entry.channel
    address, j1939 = wanted.source_address, holder.entry.j1939
    if address is None and message.name in loaded.config.messages:
        address = loaded.config.messages[message.name].source_address
    key = message.name, channel, address
    return groups.setdefault(key, _MessageSignals(message, channel, j1939, address)), signal


def _sign_of(
    loaded: LoadedConfig,
    databases: Sequence[LoadedDatabase],
    groups: Groups,
    wanted: Wanted,
    group: _MessageSignals,
    signal: Signal,
) -> int | SignBit:
    """Return the sign of a magnitude: the index of its sign signal in the same message, or a
    `SignBit` of another message."""
    path = wanted.source.sign_signal or ""
    at_place = structs.replace(wanted, place=(*wanted.place, "sign_signal"))
    of_sign, sign = _grouped(loaded, databases, groups, at_place, path)
    if sign.length != 1 or path == wanted.source.signal:
        text = "it must be a signal of one bit, and not the magnitude itself"
        raise loaded.error(at_place.place, f"{path} cannot be the sign: {text}")
    if signal.is_signed or signal.is_float:
        text = f"{wanted.source.signal} is signed already: remove 'sign_signal'"
        raise loaded.error(at_place.place, text)
    known = of_sign.names.index(sign.name) if sign.name in of_sign.names else None
    index = _added(of_sign, sign) if known is None else known
    if of_sign is group:
        return index
    is_sensor = wanted.channel.partition("/")[0] in SENSORS
    try:
        match = id_match(of_sign.message, of_sign.j1939, of_sign.channel, of_sign.source_address)
    except DatabaseError as error:
        raise loaded.error(at_place.place, str(error)) from None
    if is_sensor and is_of_any_sender(match):
        name = of_sign.message.name
        text = f"state the 'source_address:' of {name}: several control units may send it"
        raise loaded.error(at_place.place, text)
    if any(isinstance(s, SignBit) for s in of_sign.signs.values()) or group.given:
        names = f"{of_sign.message.name} and {group.message.name}"
        text = f"{names}: of two messages, only one may take its sign from another message"
        raise loaded.error(at_place.place, text)
    return of_sign.given.setdefault(index, SignBit((match, field_of(sign))))


def _signed_index(group: _MessageSignals, signal: Signal, sign: int | SignBit | None) -> int:
    """Return the index of a signal with a given sign in the group of requested signals. The signal
    is added if necessary."""
    for index, name in enumerate(group.names):
        if name == signal.name and group.signs.get(index) == sign:
            return index
    index = _added(group, signal)
    if sign is not None:
        group.signs[index] = sign
    return index


def _added(group: _MessageSignals, signal: Signal) -> int:
    group.names.append(signal.name)
    return len(group.names) - 1


def _add_status(
    loaded: LoadedConfig, group: _MessageSignals, wanted: Wanted, valid: cfg.ValidWhen
) -> None:
    try:
        name = group.message.signal(valid.signal).name
    except DatabaseError as error:
        raise loaded.error((*wanted.place, "valid_when", "signal"), str(error)) from None
    if name not in group.names:
        group.names.append(name)
    place, signal = (*wanted.place, "valid_when", "equals"), group.message.signal(name)
    values = _possible(loaded, place, as_decoded, signal, valid.values)
    status = Status(group.names.index(name), values)
    group.statuses.setdefault((wanted.channel, wanted.rank), []).append(status)


def _find(
    loaded: LoadedConfig, databases: Sequence[LoadedDatabase], wanted: Wanted, path: str
) -> tuple[LoadedDatabase, Message, Signal]:
    problems: list[str] = []
    for holder in databases:
        try:
            message, signal = holder.database.signal(path)
        except DatabaseError as error:
            problems.append(str(error))
            continue
        return holder, message, signal
    nearest = [text for text in problems if "has no signal" in text or "; write" in text]
    raise loaded.error(wanted.place, "; ".join(dict.fromkeys(nearest[:1] or problems)))


def _conversion(loaded: LoadedConfig, wanted: Wanted, signal: Signal | None) -> Conversion:
    source = wanted.source
    text = source.unit if source.unit is not None else signal.unit if signal else None
    try:
        unit = _unit(text, wanted.dimension)
    except ConfigError as error:
        where = "" if source.unit is not None else " in the database; set 'unit:' here"
        raise loaded.error(wanted.place, f"{error}{where}") from None
    low, high = source.range if source.range is not None else (-math.inf, math.inf)
    not_available, equals = source.not_available, source.on_values
    if signal is not None:
        place = (*wanted.place, "not_available")
        not_available = _possible(loaded, place, check_raw, signal, not_available)
    if signal is not None and equals is not None:
        equals = _possible(loaded, (*wanted.place, "equals"), as_decoded, signal, equals)
    if signal is not None and isinstance(signal.invalid_raw, int):
        not_available = (*not_available, signal.invalid_raw)
    if signal is not None and source.value_table:
        not_available = (*not_available, *no_values(signal.choices))
    return Conversion(
        unit=unit,
        sign=float(source.sign),
        offset=source.offset,
        low=low,
        high=high,
        rails=_rails(signal, source) if wanted.channel in _SENSORS else None,
        not_available=not_available,
        on_values=equals,
        on_above=source.above,
        step=_step(signal, unit),
    )


def _possible(
    loaded: LoadedConfig,
    place: Place,
    check: Callable[[Signal, Number], Number],
    signal: Signal,
    numbers: Iterable[Number],
) -> tuple[Number, ...]:
    """Apply `check` to configured numbers, and return the results. If `check` refuses a number,
    ConfigError states the place in the configuration."""
    try:
        return tuple(check(signal, number) for number in numbers)
    except (ConfigError, DatabaseError) as error:
        raise loaded.error(place, str(error)) from None


def _step(signal: Signal | None, unit: Unit) -> float:
    if signal is None or signal.is_float:
        return 0.0
    try:
        return abs(float(signal.scale) * unit.factor)
    except OverflowError:  # a whole number of any size; who decodes the signal refuses it
        return 0.0


def _unit(text: str | None, dimension: str) -> Unit:
    if not text and dimension != "flag":
        names = ", ".join(unit_names(dimension))
        raise ConfigError(f"no unit is stated; use one of: {names}")
    return find_unit(text or "", dimension)


def _rails(signal: Signal | None, source: cfg.SourceSettings) -> tuple[float, float] | None:
    """Return the lowest and the highest physical value of the signal, at which the sensor is
    saturated; None if not applicable."""
    if signal is None or signal.is_float:
        return None
    try:
        ends = [float(raw * signal.scale + signal.offset) for raw in raw_limits(signal)]
    except OverflowError:  # whole numbers of any size; who decodes the signal refuses it
        return None
    low, high = min(ends), max(ends)
    if source.sign_signal is not None:  # a magnitude ends at zero, the sensor does not
        low = -high
    if source.range is None and signal.minimum is not None and signal.maximum is not None:
        high = min(high, signal.maximum)
        low = -high if source.sign_signal is not None else max(low, signal.minimum)
    return (low, high) if low < high else None


def _raw_route(
    loaded: LoadedConfig, databases: Sequence[LoadedDatabase], wanted: Wanted, raw: cfg.RawSource
) -> RawRoute:
    from imucald.inputs.expression import Expression  # noqa: PLC0415 - few have a raw source

    if wanted.planar:
        raise loaded.error(wanted.place, SPLIT_PLANAR)
    try:
        when = Expression(raw.when) if raw.when is not None else None
        value = Expression(raw.value)
    except ConfigError as error:
        raise loaded.error((*wanted.place, "raw"), str(error)) from None
    if wanted.source.unit is None and wanted.dimension != "flag":
        names = ", ".join(unit_names(wanted.dimension))
        raise loaded.error(wanted.place, f"a raw source needs 'unit:'; use one of: {names}")
    match = IdMatch(
        raw.id | (CAN_EFF_FLAG if raw.is_extended else 0),
        CAN_EFF_MASK if raw.is_extended else CAN_SFF_MASK,
        wanted.source.channel,
    )
    component = Component(0, _conversion(loaded, wanted, None))
    tap = Tap(wanted.channel, wanted.rank, (component,), (wanted.slot,), wanted.width == 1)
    name, checker = _raw_checker(loaded, databases, match)
    return RawRoute(f"id 0x{raw.id:X}", match, when, value, tap, name, checker)


def _raw_checker(
    loaded: LoadedConfig, databases: Sequence[LoadedDatabase], match: IdMatch
) -> tuple[str, MessageChecker | None]:
    """Return the configured message of a raw source (by identifier), and its checker."""
    for name, protection in loaded.config.messages.items():
        for holder in databases:
            message = holder.database.messages.get(name)
            if message is None or message.unsupported:
                continue
            if (match.can_id ^ message.can_id) & id_match(message, holder.entry.j1939).full_mask:
                continue
            try:
                return name, checker_for(message, protection)
            except (DatabaseError, ConfigError) as error:
                raise loaded.error(("messages", name), str(error)) from None
    return "", None


def _message_route(loaded: LoadedConfig, group: _MessageSignals) -> MessageRoute:
    protection = loaded.config.messages.get(group.message.name)
    place: Place = ("messages", group.message.name)
    if protection is None and group.wanted:
        place = group.wanted[0][0].place
    try:
        plan = compile_decode(
            group.message, group.names, group.j1939, group.channel, group.source_address, True
        )
        taps = list(_taps(group))
        needed = [max(plan.ends[component.index] for component in tap.components) for tap in taps]
        needed += [plan.ends[index] for index in group.given]
        checker = checker_for(group.message, protection, min(needed))
    except (DatabaseError, ConfigError) as error:
        raise loaded.error(place, str(error)) from None
    return MessageRoute(plan, checker, taps, group.signs, group.given)


def _taps(group: _MessageSignals) -> Iterator[Tap]:
    taps: dict[Hashable, list[tuple[Wanted, int, Conversion]]] = {}
    for member in group.wanted:
        taps.setdefault(_tap_key(group, member[0], member[1]), []).append(member)
    for found in taps.values():
        members = sorted(found, key=lambda m: m[0].slot)
        channel, rank = members[0][0].channel, members[0][0].rank
        first = members[0][0]
        needed = first.width - first.planar
        complete = len(members) == needed
        yield Tap(
            channel,
            rank,
            tuple(Component(index, conversion) for _, index, conversion in members),
            tuple(w.slot for w, _, _ in members),
            complete,
            _third(first) if complete else None,
            tuple(dict.fromkeys(group.statuses.get((channel, rank), ()))),
        )


def _tap_key(group: _MessageSignals, wanted: Wanted, index: int) -> Hashable:
    """Return a key that is equal for numbers in the same frame (same multiplexer values)."""
    selectors = group.message.signal(group.names[index]).selectors
    return wanted.channel, wanted.rank, selectors


def _third(wanted: Wanted) -> float | None:
    """Return the assumed value of the missing axis of a two-axis sensor: gravity for an
    accelerometer, else NaN. None for a sensor with three axes."""
    if not wanted.planar:
        return None
    return PLANAR_Z if wanted.channel == "accel" else math.nan


def _refuse_unknown_messages(loaded: LoadedConfig, used: Collection[str]) -> None:
    for name in loaded.config.messages:
        if name not in used:
            known = ", ".join(sorted(used))
            raise loaded.error(
                ("messages", name),
                "the configuration takes no signal from this message; it "
                f"takes signals from: {known}",
            )


def _refuse_unknown_checksums(loaded: LoadedConfig) -> None:
    config = loaded.config
    asked: list[tuple[Place, str, Iterable[str]]] = [
        (("messages", name, "checksum", "kind"), protection.checksum.kind, KINDS)
        for name, protection in config.messages.items()
        if protection.checksum is not None
    ]
    asked.append((("output", "checksum"), config.output.checksum, ONE_BYTE_KINDS))
    for place, kind, kinds in asked:
        known = (NO_CHECKSUM, *kinds)
        if kind not in known:
            text = f"{kind!r} is not a known kind of checksum (known: {', '.join(known)})"
            raise loaded.error(place, text)


def _refuse_split_planar(loaded: LoadedConfig, groups: Iterable[_MessageSignals]) -> None:
    for group in groups:
        planar = [(w, _tap_key(group, w, index)) for w, index, _ in group.wanted if w.planar]
        count = Counter(key for _, key in planar)
        for wanted, key in planar:
            if count[key] < 2:
                raise loaded.error(wanted.place, SPLIT_PLANAR)
