"""Connect each configured number with its signal, and report what is known of each number."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from imucald.can.columns import CAN_EFF_MASK
from imucald.can.dbc.message import Signal
from imucald.config import LoadedConfig, Wheels
from imucald.config_check.finding import Finding
from imucald.config_check.statistics import Probe, SignalStatistics
from imucald.core.samples import DIMENSIONS, QUANTITIES
from imucald.inputs.quantities import Wanted, wanted_numbers
from imucald.inputs.routes import MessageRoute

_NAMES_SIGN = re.compile("sign|vz|vorz|dir|richt|neg|left|right|links|rechts", re.I)


def configured_name(channel: str) -> str:
    """Return the name of a channel in the configuration."""
    return QUANTITIES[channel].key if channel in QUANTITIES else channel.replace("/", ".")


@dataclass(frozen=True)
class QuantitySource:
    """One configured number (such as an axis of a sensor) with the statistics of its signal."""

    wanted: Wanted
    probe: Probe
    signal: Signal | None
    name: str
    statistics: SignalStatistics

    @property
    def quantity(self) -> str:
        """The quantity's name in the configuration, with axis or wheel."""
        word = configured_name(self.wanted.channel)
        if self.wanted.width == 3:
            return f"{word}.{'xyz'[self.wanted.slot]}"
        wheel = Wheels.__struct_fields__[self.wanted.slot]
        return f"{word}.{wheel}" if self.wanted.width == 4 else word

    @property
    def unit(self) -> str:
        """The source's unit, as written in the configuration or the database."""
        stated = self.wanted.source.unit
        return stated if stated is not None else self.signal.unit if self.signal else ""


def sources(loaded: LoadedConfig, probes: Sequence[Probe]) -> Iterator[QuantitySource]:
    """Yield all configured numbers, in the order of the configuration."""
    by_key: dict[tuple[str, int, int], tuple[Probe, str, Signal | None]] = {}
    for probe in probes:
        route = probe.route
        for tap in probe.taps:
            for component, slot in zip(tap.components, tap.slots, strict=True):
                name, signal = probe.name, None
                if isinstance(route, MessageRoute):
                    signal = route.plan.message.signal(route.plan.signal_names[component.index])
                    name = f"{probe.name}.{signal.name}"
                by_key[tap.channel, tap.rank, slot] = probe, name, signal
    for wanted in wanted_numbers(loaded.config.signals):
        key = wanted.channel, wanted.rank, wanted.slot
        probe, name, signal = by_key[key]
        yield QuantitySource(wanted, probe, signal, name, probe.signals[key])


def never_negative(sources: Iterable[QuantitySource]) -> dict[str, str]:
    """For each signed quantity that was never negative, return a text about signals that may
    contain its sign.

    Only the first source of each quantity is used. The possible signals are the one-bit signals of
    the same message.
    """
    found = {}
    for source in sources:
        values, wanted = source.statistics.physical, source.wanted
        has_sides = wanted.channel in ("yaw_rate", "steering", "lateral_accel")
        if not has_sides or wanted.rank or wanted.source.sign_signal or not values.count:
            continue
        if values.least >= 0.0 and values.largest > 0.0:
            route = source.probe.route
            message = route.plan.message if isinstance(route, MessageRoute) else None
            bits = [] if message is None else [
                f"{message.name}.{s.name}" for s in message.signals.values() if s.length == 1
            ]  # fmt: skip
            named = [b for b in bits if _NAMES_SIGN.search(b.partition(".")[2])]
            found[source.quantity] = " or ".join((named or bits)[:3])
    return found


def turned_quantities(sources: Iterable[QuantitySource]) -> dict[str, bool]:
    """Return for each quantity whether the configuration reverses the signs of all axes of its
    first source.

    Quantities with a separate sign bit are not in the result, because in some vehicles a set bit
    means left and in others right.
    """
    turned: dict[str, bool] = {}
    for source in sources:
        if source.wanted.rank == 0 and not source.wanted.source.sign_signal:
            name = source.quantity.partition(".")[0]
            turned[name] = turned.get(name, True) and source.wanted.source.sign < 0
    return turned


def signs_of_speed(sources: Iterable[QuantitySource]) -> str:
    """Return a text with the keys that determine the sign of the first source of the speed."""
    speed = next(s.wanted for s in sources if s.wanted.channel == "speed" and not s.wanted.rank)
    return ("'sign_signal:' and " if speed.source.sign_signal else "") + "'sign:'"


def message_row(loaded: LoadedConfig, probe: Probe) -> dict[str, Any]:
    """Return the JSON data of a message."""
    return {
        "name": probe.name,
        "id": id_text(probe.can_id),
        "channel": probe.match.channel,
        "frames": probe.frames,
        "cycle_s": round(probe.cycles[0], 6) if probe.cycles else None,
        "stated_cycle_s": stated_cycle(loaded, probe),
        "lost_share": None if probe.lost_share is None else round(probe.lost_share, 4),
        "rejected": dict(sorted(probe.rejected.items())),
    }


def quantity_row(source: QuantitySource) -> dict[str, Any]:
    """Return the JSON data of a configured number."""
    conversion = source.statistics.conversion
    return {
        "quantity": source.quantity,
        "preference": source.wanted.rank,
        "source": source.name,
        "id": id_text(source.probe.can_id),
        "unit": source.unit,
        "si_unit": DIMENSIONS[conversion.unit.dimension].unit,
        "factor": conversion.unit.factor * conversion.sign,
        "samples": source.statistics.si.count,
        "in_unit": source.statistics.physical.as_dict(),
        "in_si": source.statistics.si.as_dict(),
        "rejected": dict(sorted(source.statistics.rejected.items())),
    }


def stated_cycle(loaded: LoadedConfig, probe: Probe) -> float | None:
    """Return the cycle time [s] that the configuration or the database states."""
    if not isinstance(probe.route, MessageRoute):
        return None
    protection = loaded.config.messages.get(probe.name)
    own = protection.cycle_time if protection is not None else None
    return own or probe.route.plan.message.cycle_time


def id_text(can_id: int) -> str:
    """Return the text of an identifier, without its flag."""
    return f"0x{can_id & CAN_EFF_MASK:X}"


def unit_advice(sources: Iterable[QuantitySource]) -> dict[str, str]:
    """Return advice for each quantity with a stated unit: the stated unit, the unit in the
    database, and the remedy. The keys are names of axes and of sensors in the configuration, such
    as "accelerometer.x" and "accelerometer".
    """
    made: dict[str, str] = {}
    for source in sources:
        unit = source.wanted.source.unit
        if unit is None:
            continue
        advice = f"'unit: {unit}' is set: correct it"
        if source.signal is not None and source.signal.unit not in ("", unit):
            database = source.signal.unit
            advice = (
                f"'unit: {unit}' is set: remove it (the unit in the database is {database}) "
                "or correct it"
            )
        parts = source.quantity.split(".")
        for i in range(len(parts)):
            made.setdefault(".".join(parts[: i + 1]), advice)
    return made


def not_judged(rows: Sequence[QuantitySource], found: Iterable[Finding]) -> Iterator[Finding]:
    """Yield one note that names all received quantities that occur in no finding."""
    judged = {name.partition(".")[0] for f in found for name in (f.quantity, *f.beside)}
    left: dict[str, str] = {}
    for row in rows:
        name = row.quantity.partition(".")[0]
        values = row.statistics.si
        if name not in judged and values.count:
            is_flag = row.statistics.conversion.unit.dimension == "flag"
            same = values.least == values.largest
            word = (" (never on)", " (always on)")[values.least > 0.5] if is_flag and same else ""
            left.setdefault(name, name + word)
    if left:
        text = f"checked for unit and range only: {', '.join(left.values())}"
        yield Finding("note", "check", text)
