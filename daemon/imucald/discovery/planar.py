"""Use the two accelerations of the stability control in a vehicle without a three-axis sensor."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucald.config_check.motion import Motion, change_of, moving, right_less_left
from imucald.config_check.relation import Relation, relation
from imucald.core.arrays import Array
from imucald.discovery.candidates import SeenSignal
from imucald.discovery.evidence import RELATED, UnitChoice, stated_unit, unit_for
from imucald.discovery.names import WHEELS, wheel_by_name
from imucald.discovery.proposal import MAX_ALTERNATIVES, Alternative, Choice, source_of
from imucald.discovery.reference import KnownMotion, SpeedFit, speed_candidates

_LEFT = re.compile(r"(positive|\+|>\s*0)[^.;]{0,20}\bleft|left[^.;]{0,20}(positive|\+)", re.I)
WRONG_SCALE = 2.0
"""Largest accepted ratio of a measured scale to the stated scale. Reverse-engineered databases have
such errors. A larger ratio means another unit."""


@dataclass
class Planar:
    """The result: the two-axis accelerometer, the speed, and the motion that both show."""

    reference: KnownMotion
    accelerometer: Choice
    speed: Choice | None
    taken: set[str]


@dataclass(frozen=True, eq=False)
class _Pair:
    """A signal and another signal that follows it."""

    first: SeenSignal
    second: SeenSignal
    relation: Relation
    unit: UnitChoice


def find_planar(
    candidates: Sequence[SeenSignal], wheels: Sequence[SeenSignal] | None, taken: set[str]
) -> Planar | None:
    """Find two accelerations: one that follows the change of speed, and one that follows speed
    times yaw rate."""
    accelerations = [c for c in candidates if c.states("acceleration") and not c.is_constant]
    speeds = [c for c in speed_candidates(candidates) if c.states("speed")]
    along = _along(speeds, accelerations)
    own = [p for p in along if p.first.path not in taken] or along
    if not own:
        return None
    for best in own:  # one sensor sends both axes in one message
        unit = stated_unit(best.first.unit, "speed")
        assert unit is not None, "only speeds that state their unit were tried"
        fit = SpeedFit(best.first, unit, best.relation)
        others = [c for c in accelerations if c.message is best.second.message]
        v = moving(best.first.smooth * unit.factor)
        across = _across(v, candidates, [c for c in others if c is not best.second])
        if across is not None:
            break
    else:
        return None
    yaw_unit = stated_unit(across.first.unit, "angular_rate")
    assert yaw_unit is not None, "only rates that state their unit were tried"
    sign, shows_left = _sides(v, candidates, wheels, across.first)
    level = [
        best.second.x * (best.unit.factor * best.relation.sign),
        across.second.x * (across.unit.factor * sign * across.relation.sign),
    ]
    grid = {
        "accel": np.column_stack(level),
        "speed": best.first.x * unit.factor,
        "yaw_rate": across.first.x * (yaw_unit.factor * sign),
    }
    reference = KnownMotion(Motion(grid, planar=True), speed=fit, shows_left=shows_left)
    sources = {
        "x": source_of(best.second, best.unit.name, best.relation.sign),
        "y": source_of(across.second, across.unit.name, sign * across.relation.sign),
    }
    evidence = (
        "no three signals form a vector of 1 g, so these are two level axes. x "
        f"follows the change of speed (correlation {best.relation.correlation:+.2f}). y "
        f"follows speed times {across.first.path} (correlation "
        f"{across.relation.correlation:+.2f})"
    )
    doubt = "" if shows_left else "no signal shows which side is left: the sign of y may be wrong"
    used = {best.second.path, across.second.path}
    speed = None
    if best.first.path not in taken:
        used.add(best.first.path)
        speed = _speed_choice(best, [p for p in own[1:] if p.first is not best.first])
    return Planar(reference, Choice("accelerometer", sources, evidence, doubt), speed, used)


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


def _along(speeds: list[SeenSignal], accelerations: list[SeenSignal]) -> list[_Pair]:
    """Return pairs of a speed and the acceleration that follows the changes of this speed, the best
    first."""
    pairs = []
    for v in speeds:
        own = stated_unit(v.unit, "speed")
        for a in accelerations:
            if own is None:
                continue
            found = relation(change_of(v.smooth * own.factor), a.smooth)
            unit = unit_for(a.unit, "acceleration", found, (1.0 / WRONG_SCALE, WRONG_SCALE))
            if unit is not None and _is_clear(found, len(speeds) * len(accelerations)):
                pairs.append(_Pair(v, a, found, unit))
    return sorted(pairs, key=lambda p: -p.relation.explained)


def _across(
    v: Array, candidates: Sequence[SeenSignal], accelerations: list[SeenSignal]
) -> _Pair | None:
    """Return a yaw rate and the acceleration that equals speed times this yaw rate; None if there
    is no such pair."""
    rates = [(c, stated_unit(c.unit, "angular_rate")) for c in candidates if not c.is_constant]
    pairs = []
    for rate, own in rates:
        for a in accelerations:
            if own is None:
                continue
            found = relation(v * rate.smooth * own.factor, a.smooth)
            unit = unit_for(a.unit, "acceleration", found)
            if unit is not None and _is_clear(found, len(rates) * len(accelerations)):
                pairs.append(_Pair(rate, a, found, unit))
    return max(pairs, key=lambda p: p.relation.explained, default=None)


def _is_clear(found: Relation, comparisons: int) -> bool:
    return found.is_believed_of(comparisons) and found.explained >= RELATED


def _sides(
    v: Array, candidates: Sequence[SeenSignal], wheels: Sequence[SeenSignal] | None, yaw: SeenSignal
) -> tuple[int, bool]:
    """Return the sign that makes a yaw rate positive to the left, and whether a signal or a comment
    shows this sign."""
    if wheels:
        named = [wheel_by_name(c.signal.name) for c in wheels]
        if sorted(n or "" for n in named) == sorted(WHEELS):
            fl, fr, rl, rr = (wheels[named.index(w)].smooth for w in WHEELS)
            found = relation(yaw.smooth / v, right_less_left(fl, fr, rl, rr) / v)
            if found.is_believed_of(1):
                return found.sign, True
    if _LEFT.search(yaw.signal.comment):
        return 1, True
    for c in candidates:
        if _LEFT.search(c.signal.comment) and c.states("angle"):
            found = relation(yaw.smooth, c.smooth * v)
            if _is_clear(found, 1):
                return found.sign, True
    return 1, False
