"""Three-axis sensors: find three signals that belong together, and their unit.

The three axes of an accelerometer form a vector. The magnitude of this vector at rest is 1 g for
any mount.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from imucald.config_check.judgement import REST_WRONG
from imucald.core.arrays import Array
from imucald.core.samples import GRAVITY
from imucald.discovery.candidates import MEASURED_BITS, SeenSignal
from imucald.discovery.evidence import COMMON_UNITS, UnitChoice, choose_unit, in_counts, stated_unit
from imucald.discovery.names import axes_by_name
from imucald.inputs.units import find_unit, is_unit

MAX_TOGETHER = 12
"""Largest number of similar signals in a message of which any three are tested. With more signals,
only adjacent signals are tested."""
SCALE_AND_OFFSET = 0.08
"""Largest relative error of a sensor's 1 g: 5 % of scale and 30 mg of offset (consumer MEMS)."""
NORM_SPREAD = 0.05
"""Largest relative spread of the vector's magnitude in a drive.

A manoeuvre of 0.3 g increases the size by sqrt(1 + 0.3^2) - 1 = 0.04. In most of a drive, the
manoeuvres are weaker."""
CALM_PART = 0.1
"""Share of a drive in which even a racing driver neither brakes nor turns. In this share of a
drive, the magnitude of the smoothed specific force is 1 g or slightly more."""
BY_PLACES = "the axes are in the order of their bits"
EARTH_FIELD = (22e-6, 67e-6)
"""Range of the earth's magnetic field [T] (World Magnetic Model)."""


@dataclass(frozen=True, eq=False)
class Triad:
    """Three signals as x, y, z. names_axes: True if the names of the signals show the axes."""

    members: tuple[SeenSignal, SeenSignal, SeenSignal]
    unit: UnitChoice
    names_axes: bool
    size: float = math.nan
    """Median magnitude of the vector in SI. With hard driving, a low quantile of the size is used
    instead."""
    spread: float = math.nan
    """Robust relative standard deviation of the size."""

    @property
    def ticks(self) -> Array:
        """Values (n, 3) in SI."""
        return np.column_stack([m.x for m in self.members]) * self.unit.factor

    @property
    def apart(self) -> int:
        """Largest difference between the identifiers of the messages with the three axes; 0 for a
        single message.
        """
        ids = [m.message.can_id for m in self.members]
        return max(ids) - min(ids)

    @property
    def messages(self) -> tuple[str, ...]:
        """Names of the messages of the triad (three signals x, y, z)."""
        return tuple(dict.fromkeys(m.message.name for m in self.members))


def accelerometers(candidates: Sequence[SeenSignal]) -> list[Triad]:
    """Return all triads (three signals x, y, z) whose vector has a magnitude of 1 g, the most
    likely first.
    """
    found: list[Triad] = []
    for three in _threes(candidates, "acceleration"):
        fit = _of_one_g(three)
        if fit is not None:
            found.append(fit)
    found.sort(key=_accelerometer_rank)
    return _without_overlap(found)


def in_raw_counts(candidates: Sequence[SeenSignal]) -> list[Triad]:
    """Return all triads (three signals x, y, z) without a unit whose names show the axes and whose
    vector has a constant magnitude in counts.

    The vector of a magnetometer also has a constant magnitude (the earth's field). An accelerometer
    and a magnetometer can be distinguished only by the vehicle's motion.
    """
    found = []
    for three in _threes(candidates, "acceleration"):
        ordered, named = in_order(three)
        _, middle, spread = _sizes(ordered)
        is_integer = all(m.signal.scale == 1.0 and not is_unit(m.unit) for m in ordered)
        if named and is_integer and spread < NORM_SPREAD:
            sizes = ((1.0 + s * SCALE_AND_OFFSET) * GRAVITY / middle for s in (-1.0, 1.0))
            unit = in_counts("acceleration", *sizes)
            found.append(Triad(ordered, unit, named, middle * unit.factor, spread))
    return _without_overlap(found)


def _accelerometer_rank(triad: Triad) -> tuple[bool, bool, bool, int, float]:
    """Return the sort key. A stated unit comes first, then named axes, then a single message or
    near messages, then the most constant magnitude."""
    stated = all(m.states("acceleration") for m in triad.members)
    apart = triad.apart
    return not stated, not triad.names_axes, apart > 0, apart, triad.spread


def _sizes(three: tuple[SeenSignal, ...]) -> tuple[Array, float, float]:
    """Return the sizes (n,) of a vector in the unit of its signals, their median, and their
    relative spread; 0.0 and infinite if the size is unknown."""
    size = np.linalg.norm(np.column_stack([m.smooth for m in three]), axis=1)
    size = size[np.isfinite(size)]
    middle = float(np.median(size)) if len(size) else 0.0
    if not middle > 0.0:
        return size, 0.0, math.inf
    return size, middle, 1.4826 * float(np.median(np.abs(size - middle))) / middle


def _of_one_g(three: tuple[SeenSignal, ...]) -> Triad | None:
    ordered, named = in_order(three)
    size, middle, spread = _sizes(ordered)
    if not middle > 0.0:
        return None
    if spread > NORM_SPREAD:
        # hard driving: the calm part is compared with 1 g if the database states the unit
        middle = float(np.quantile(size, CALM_PART))
        unit = _one_g_unit(ordered[0].unit, middle, SCALE_AND_OFFSET) if middle > 0.0 else None
        if unit is None or not unit.is_stated or len({m.message.name for m in three}) > 1:
            return None
        return Triad(ordered, unit, named, middle * unit.factor, spread)
    for tolerance in (SCALE_AND_OFFSET, REST_WRONG):
        unit = _one_g_unit(ordered[0].unit, middle, tolerance)
        if unit is not None and (tolerance == SCALE_AND_OFFSET or unit.is_stated):
            return Triad(ordered, unit, named, middle * unit.factor, spread)
    return None


def of_another_size(candidates: Sequence[SeenSignal]) -> str:
    """Return a text about three accelerations of a message whose magnitude is constant but not 1 g;
    empty if there are none.

    The magnitude of gravity is constant in any drive. With a wrong scale in the database, the size
    is constant at another value. Only signals with a unit and with names of axes count.
    """
    for three in _threes(candidates, "acceleration"):
        ordered, named = in_order(three)
        if not named or not all(m.states("acceleration") for m in ordered):
            continue
        if len({m.message.name for m in ordered}) > 1:
            continue
        _, middle, spread = _sizes(ordered)
        middle *= _stated_or_first(ordered[0], "acceleration").factor
        if not middle > 0.0 or abs(middle / GRAVITY - 1.0) < REST_WRONG or spread > NORM_SPREAD:
            continue
        names = ", ".join((ordered[0].path, *(m.signal.name for m in ordered[1:])))
        return (
            f"{names} look like the sensor, but their vector has {middle:.3g} m/s^2, "
            f"and gravity is {GRAVITY:.2f}: the scale in the database seems to be "
            f"{middle / GRAVITY:.3g} times the right one"
        )
    return ""


def _one_g_unit(stated: str, size: float, tolerance: float) -> UnitChoice | None:
    """Return the unit in which a size is 1 g within a relative tolerance."""
    low, high = ((1.0 + s * tolerance) * GRAVITY / size for s in (-1.0, 1.0))
    return choose_unit(stated, "acceleration", low, high)


def gyroscopes(candidates: Sequence[SeenSignal]) -> list[Triad]:
    """Return all triads (three signals x, y, z) that may be angular rates.

    The unit is not yet checked.
    """
    found = []
    for three in _threes(candidates, "angular_rate"):
        ordered, named = in_order(three)
        unit = _stated_or_first(ordered[0], "angular_rate")
        found.append(Triad(ordered, unit, named))
    found.sort(key=lambda t: (not t.unit.is_stated, not t.names_axes, t.apart))
    return found


def magnetometers(candidates: Sequence[SeenSignal]) -> list[Triad]:
    """Return all triads (three signals x, y, z) with a unit of the magnetic field."""
    found = []
    for three in _threes(candidates, "magnetic_field"):
        ordered, named = in_order(three)
        if not ordered[0].states("magnetic_field"):
            continue
        unit = _stated_or_first(ordered[0], "magnetic_field")
        found.append(Triad(ordered, unit, named, _sizes(ordered)[1] * unit.factor))
    return _without_overlap(found)


def _stated_or_first(candidate: SeenSignal, dimension: str) -> UnitChoice:
    unit = stated_unit(candidate.unit, dimension)
    if unit is not None:
        return unit
    name, *others = COMMON_UNITS[dimension]
    return UnitChoice(name, find_unit(name, dimension).factor, False, tuple(others))


def in_order(
    three: tuple[SeenSignal, ...],
) -> tuple[tuple[SeenSignal, SeenSignal, SeenSignal], bool]:
    """Return three signals in the order x, y, z: by their names, or else by their position. The
    second result is True if names were used."""
    named = axes_by_name(three)
    if named is not None:
        x, y, z = (three[i] for i in named)
        return (x, y, z), True
    a, b, c = sorted(three, key=_place)
    return (a, b, c), False


def _place(candidate: SeenSignal) -> tuple[int, int]:
    """Return the identifier, and the position of the first bit from the start of the payload."""
    signal = candidate.signal
    big = signal.byte_order == "big_endian"
    bit = 8 * (signal.start // 8) + 7 - signal.start % 8 if big else signal.start
    return candidate.message.can_id, bit


def _threes(
    candidates: Sequence[SeenSignal], dimension: str
) -> Iterator[tuple[SeenSignal, SeenSignal, SeenSignal]]:
    """Yield sets of three similar signals, from one, two or three messages."""
    usable = [
        c
        for c in candidates
        if c.may_be(dimension) and c.signal.length >= MEASURED_BITS and not c.levels
    ]
    groups: dict[tuple[object, ...], list[SeenSignal]] = {}
    for c in usable:
        groups.setdefault((c.message.name, *_kind(c, dimension)), []).append(c)
    for group in groups.values():
        yield from _combinations(sorted(group, key=_place))
    across: dict[object, list[SeenSignal]] = {}
    for (_, *kind), group in groups.items():
        is_part = len(group) <= 2 and _alike(group[0]) <= 2
        across.setdefault(tuple(kind), []).extend(group if is_part else ())
    for group in across.values():
        group.sort(key=_place)
        of_pace: dict[int, list[SeenSignal]] = {}
        for c in group:
            of_pace.setdefault(_pace(c), []).append(c)
        for equal in of_pace.values():
            if len(equal) <= MAX_TOGETHER:
                yield from filter(_are_across, itertools.combinations(equal, 3))
        if len(of_pace) > 1 and len(group) <= MAX_TOGETHER:
            for three in itertools.combinations(group, 3):  # at different rates, names must agree
                if len({_pace(c) for c in three}) > 1 and axes_by_name(three) is not None:
                    yield three


def _alike(c: SeenSignal) -> int:
    """Return the number of similar signals of the message in the database. If an axis is missing
    only because frames were cut, it is not in another message."""
    signals = c.message.signals.values()
    return sum((s.unit, s.length) == (c.signal.unit, c.signal.length) for s in signals)


def _are_across(three: tuple[SeenSignal, ...]) -> bool:
    return len({c.message.name for c in three}) > 1


def _pace(c: SeenSignal) -> int:
    """Return a number that is equal for signals whose rates agree within an eighth."""
    return round(4.0 * math.log(c.cycle + 1e-6))


def _combinations(group: list[SeenSignal]) -> Iterator[tuple[SeenSignal, SeenSignal, SeenSignal]]:
    if len(group) <= MAX_TOGETHER:
        yield from itertools.combinations(group, 3)
    else:
        yield from zip(group, group[1:], group[2:], strict=False)


def _kind(c: SeenSignal, dimension: str) -> tuple[object, ...]:
    """Return a key of the properties that all axes of one sensor have in common."""
    if c.states(dimension):
        return (c.unit,)
    return "", c.signal.length, c.signal.scale


def _without_overlap(found: list[Triad]) -> list[Triad]:
    """Return the triads without those that share a signal with a better one."""
    used: set[str] = set()
    kept = []
    for triad in found:
        paths = {m.path for m in triad.members}
        if not paths & used:
            kept.append(triad)
            used |= paths
    return kept
