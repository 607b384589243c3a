"""Use the two accelerations of the stability control in a vehicle without a three-axis sensor."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucald.config_check.motion import Motion, change_of, moving, right_less_left
from imucald.config_check.relation import Relation, relation
from imucald.core.arrays import Array
from imucald.discovery.candidates import SeenSignal
from imucald.discovery.evidence import GAINS, RELATED, UnitChoice, stated_unit, unit_for
from imucald.discovery.names import WHEELS, wheel_by_name
from imucald.discovery.proposal import MAX_ALTERNATIVES, Alternative, Choice, source_of
from imucald.discovery.reference import KnownMotion, SpeedFit, speed_candidates

WRONG_SCALE = 2.0
"""Largest accepted ratio of a measured scale to the stated scale. Reverse-engineered databases have
such errors. A larger ratio means another unit."""


@dataclass
class Planar:
    """The result: the motion that a two-axis accelerometer and a speed show, the choices of both,
    and the paths of their signals."""

    reference: KnownMotion
    choices: list[Choice | None]
    taken: set[str]


@dataclass(frozen=True, eq=False)
class _Pair:
    """A signal in its stated unit, and an acceleration that follows it. unit: of the
    acceleration."""

    first: SeenSignal
    stated: UnitChoice
    second: SeenSignal
    relation: Relation
    unit: UnitChoice


def find_planar(
    candidates: Sequence[SeenSignal], wheels: Sequence[SeenSignal] | None, taken: set[str]
) -> Planar | None:
    """Find two accelerations: one that follows the change of speed, and one that follows speed
    times yaw rate."""
    accelerations = [c for c in candidates if c.states("acceleration") and not c.is_constant]
    speeds = [
        (c, unit, change_of(c.smooth * unit.factor))
        for c in speed_candidates(candidates)
        if (unit := stated_unit(c.unit, "speed")) is not None
    ]
    along = _pairs(speeds, accelerations, (1.0 / WRONG_SCALE, WRONG_SCALE))
    own = [p for p in along if p.first.path not in taken] or along
    for best in own:  # one sensor sends both axes in one message
        v = moving(best.first.smooth * best.stated.factor)
        rates = [
            (c, unit, v * c.smooth * unit.factor)
            for c in candidates
            if not c.is_constant and (unit := stated_unit(c.unit, "angular_rate")) is not None
        ]
        others = [
            c for c in accelerations if c.message is best.second.message and c is not best.second
        ]
        across = next(iter(_pairs(rates, others)), None)
        if across is not None:
            break
    else:
        return None
    sign, shows_left = _sides(v, wheels, across.first)
    x_sign, y_sign = best.relation.sign, sign * across.relation.sign
    x, y = best.second.x * best.unit.factor * x_sign, across.second.x * across.unit.factor * y_sign
    grid = {
        "accel": np.column_stack([x, y]),
        "speed": best.first.x * best.stated.factor,
        "yaw_rate": across.first.x * (across.stated.factor * sign),
    }
    fit = SpeedFit(best.first, best.stated, best.relation)
    reference = KnownMotion(Motion(grid, planar=True), speed=fit, shows_left=shows_left)
    sources = {
        "x": source_of(best.second, best.unit.name, x_sign),
        "y": source_of(across.second, across.unit.name, y_sign),
    }
    evidence = (
        "no three signals form a vector of 1 g, so these are two level axes. x "
        f"follows the change of speed (correlation {best.relation.correlation:+.2f}). y "
        f"follows speed times {across.first.path} (correlation "
        f"{across.relation.correlation:+.2f})"
    )
    doubt = "" if shows_left else "no signal shows which side is left: the sign of y may be wrong"
    choices: list[Choice | None] = [Choice("accelerometer", sources, evidence, doubt)]
    used = {best.second.path, across.second.path}
    if best.first.path not in taken:
        used.add(best.first.path)
        choices.append(_speed_choice(best, [p for p in own[1:] if p.first is not best.first]))
    return Planar(reference, choices, used)


def _speed_choice(best: _Pair, others: list[_Pair]) -> Choice:
    text = f"its changes follow {best.second.path} (correlation "
    rest = [
        Alternative({"": source_of(p.first)}, f"{text}{p.relation.correlation:+.2f})")
        for p in others
    ]
    return Choice(
        "speed", {"": source_of(best.first)}, f"{text}{best.relation.correlation:+.2f})", "",
        rest[:MAX_ALTERNATIVES],
    )  # fmt: skip


def _pairs(
    firsts: Sequence[tuple[SeenSignal, UnitChoice, Array]],
    accelerations: Sequence[SeenSignal],
    gains: tuple[float, float] = GAINS,
) -> list[_Pair]:
    """Return the pairs of a signal and an acceleration that follows it, the best first.

    firsts: each signal with its stated unit and with the acceleration (n,) that it predicts.
    """
    pairs = []
    for (first, stated, predicted), second in itertools.product(firsts, accelerations):
        found = relation(predicted, second.smooth)
        unit = unit_for(second.unit, "acceleration", found, gains)
        if unit is not None and _is_clear(found, len(firsts) * len(accelerations)):
            pairs.append(_Pair(first, stated, second, found, unit))
    return sorted(pairs, key=lambda p: -p.relation.explained)


def _is_clear(found: Relation, comparisons: int) -> bool:
    return found.is_believed_of(comparisons) and found.explained >= RELATED


def _sides(v: Array, wheels: Sequence[SeenSignal] | None, yaw: SeenSignal) -> tuple[int, bool]:
    """Return the sign that makes a yaw rate positive to the left, and whether wheels show this
    sign."""
    if wheels:
        named = [wheel_by_name(c.signal.name) for c in wheels]
        if sorted(n or "" for n in named) == sorted(WHEELS):
            fl, fr, rl, rr = (wheels[named.index(w)].smooth for w in WHEELS)
            found = relation(yaw.smooth / v, right_less_left(fl, fr, rl, rr) / v)
            if found.is_believed_of(1):
                return found.sign, True
    return 1, False
