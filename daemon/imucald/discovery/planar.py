"""A vehicle without a sensor of three axes: the stability control's two axes stand in for it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucald.discovery.candidates import Candidate
from imucald.discovery.evidence import Relation, relation
from imucald.discovery.names import WHEELS, hint, wheel_by_name
from imucald.discovery.proposal import Choice, source_of
from imucald.discovery.reference import (
    Reference,
    SpeedFit,
    change_of,
    speed_candidates,
    stated_unit,
    unit_for,
)

_LEFT = re.compile(r"(positive|\+|>\s*0)[^.;]{0,20}\bleft|left[^.;]{0,20}(positive|\+)", re.I)
SAME_MOTION = 0.5


@dataclass
class Planar:
    """What was found: the two-axis accelerometer and the speed, with the motion they show."""

    reference: Reference
    accelerometer: Choice
    speed: Choice | None
    taken: set[str]


def find_planar(
    candidates: Sequence[Candidate], wheels: Sequence[Candidate] | None, taken: set[str]
) -> Planar | None:
    """Two accelerations that follow the change of speed, and speed times a yaw rate."""
    accelerations = [c for c in candidates if c.states("acceleration") and not c.is_constant]
    speeds = [c for c in speed_candidates(candidates) if c.states("speed")]
    pairs = []
    for v in speeds:
        change = change_of(v.smooth)
        for a in accelerations:
            found = relation(change, a.smooth)
            if found.is_believed and found.explained >= SAME_MOTION:
                pairs.append((found.explained, v, a, found))
    if not pairs:
        return None
    own = [p for p in pairs if p[1].path not in taken] or pairs
    _, v, along, found = max(own, key=lambda p: p[0])
    unit = stated_unit(v, "speed")
    assert unit is not None, "only stated speeds were tried"
    fit = SpeedFit(v, unit, found)
    reference = Reference(speed=fit)
    si = relation(fit.change, along.smooth)
    x_unit = unit_for(along, "acceleration", si)
    speed = None
    used = {along.path}
    if v.path not in taken:
        used.add(v.path)
        text = f"a speed in {v.unit}; {along.path} follows its changes"
        speed = Choice("speed", {"": source_of(v)}, text, "" if x_unit else "its unit is not sure")
    across = _across(reference, candidates, accelerations, along)
    sides = _sides(reference, candidates, wheels, across)
    if across is None or x_unit is None:
        return None
    y, yaw, both, y_unit = across
    used.add(y.path)
    sign, why = sides
    reference.sides_from = why
    reference.turn = sign * yaw.smooth * (stated_unit(yaw, "angular_rate") or y_unit).factor
    reference.turn_from = yaw.path
    sources = {
        "x": source_of(along, x_unit.name, si.sign),
        "y": source_of(y, y_unit.name, sign * both.sign),
    }
    evidence = (
        f"no three signals are 1 g; x follows the change of speed ({si.correlation:+.2f}), "
        f"y speed times {yaw.path} ({both.correlation:+.2f}); already level"
    )
    doubt = "" if why else "nothing tells left from right: the sign of y may be the other one"
    return Planar(reference, Choice("accelerometer", sources, evidence, doubt), speed, used)


def _across(reference, candidates, accelerations, along):  # type: ignore[no-untyped-def]
    """Lateral acceleration, yaw rate, their relation and the unit; None where there are none."""
    assert reference.speed is not None
    v = reference.speed.speed
    best = None
    for yaw in candidates:
        unit = stated_unit(yaw, "angular_rate")
        if unit is None or yaw.is_constant:
            continue
        product = v * yaw.smooth * unit.factor
        for y in accelerations:
            found = relation(product, y.smooth)
            fitting = unit_for(y, "acceleration", found)
            good = y is not along and found.is_believed and found.explained >= SAME_MOTION
            if good and fitting and (best is None or found.explained > best[2].explained):
                best = y, yaw, found, fitting
    return best


def _sides(reference, candidates, wheels, across) -> tuple[int, str]:  # type: ignore[no-untyped-def]
    """Sign that makes the yaw rate positive to the left, and what tells it."""
    if across is None:
        return 1, ""
    yaw = across[1]
    if wheels:
        named = [wheel_by_name(c.signal.name) for c in wheels]
        if sorted(n or "" for n in named) == sorted(WHEELS):
            fl, fr, rl, rr = (wheels[named.index(w)].smooth for w in WHEELS)
            found: Relation = relation(yaw.smooth, fr - fl + rr - rl)
            if found.is_believed:
                return found.sign, "the right wheels by name, which are faster in left turns"
    if _LEFT.search(yaw.signal.comment):
        return 1, f"the database's comment on {yaw.path}"
    for c in candidates:
        if _LEFT.search(c.signal.comment) and (c.states("angle") or c.states("angular_rate")):
            reference_turn = np.asarray(yaw.smooth)
            v = reference.speed.speed
            found = relation(reference_turn, c.smooth * (v if c.states("angle") else 1.0))
            if found.is_believed and found.explained >= SAME_MOTION and hint("steering_wheel_angle", c):
                return found.sign, f"the database's comment on {c.path}"
    return 1, ""
