"""Find the signals that follow the vehicle's motion: yaw rate, steering, accelerations, wheels; and
the dimensions of the vehicle that they show.

Each quantity has a reference from other signals, and a gain that is known from physics. Reference
and gain determine the sign and the unit of the signal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucald.config_check.relation import Relation, is_better, relation
from imucald.core.arrays import Array
from imucald.core.default_vehicle import WHEELBASE
from imucald.discovery.candidates import SeenSignal
from imucald.discovery.evidence import (
    GAINS,
    RELATED,
    SAME_MOTION,
    UnitChoice,
    choose_unit,
    factor_of,
    stated_unit,
    unit_for,
)
from imucald.discovery.names import by_unit_and_name
from imucald.discovery.proposal import (
    MAX_ALTERNATIVES,
    Alternative,
    Choice,
    candidate_of,
    source_of,
)
from imucald.discovery.reference import KnownMotion
from imucald.discovery.sensors import Sensors
from imucald.discovery.wheels import find_wheels

STEERING_METRES = (15.0, 130.0)
"""Range of wheelbase times steering ratio [m]. The lower limit is half the value of a small car
with a quick rack (2.4 m x 12). The upper limit is the value of a lorry (6 m x 20)."""


@dataclass(frozen=True)
class ScalarQuantity:
    """A quantity of a single signal. words: text that describes the reference, for the evidence.
    gains: range of the signal divided by the reference, both in SI. has_sides: True if the sign of
    the signal distinguishes left from right."""

    name: str
    dimension: str
    words: str
    gains: tuple[float, float] = GAINS
    has_sides: bool = True


YAW_RATE = ScalarQuantity("yaw_rate", "angular_rate", "the yaw rate")
STEERING = ScalarQuantity("steering_wheel_angle", "angle", "the curvature", STEERING_METRES)
LATERAL = ScalarQuantity("lateral_acceleration", "acceleration", "speed times yaw rate")
LONGITUDINAL = ScalarQuantity(
    "longitudinal_acceleration", "acceleration", "the change of speed", has_sides=False
)


@dataclass(frozen=True, eq=False)
class Match:
    """The comparison of a candidate with a reference."""

    candidate: SeenSignal
    relation: Relation
    unit: UnitChoice | None


def choices_of_motion(
    sensors: Sensors, free: Sequence[SeenSignal]
) -> tuple[list[Choice | None], list[tuple[str, str, str]]]:
    """Return the choices of wheels, steering, yaw rate and accelerations, and the vehicle data that
    these signals show: (key, value, evidence).

    free: signals without another use.
    """
    known = sensors.reference
    yaw_rate = _yaw_rate(known, free)
    motion, shows_left = known.motion, known.shows_left
    wheels, vehicle = _wheels(sensors)
    steering = find_scalar(STEERING, motion.curvature, free, shows_left)
    vehicle += _steering_ratio(steering, free, known)
    v, turn = motion.moving, motion.turn
    across = None if v is None or turn is None else v * turn
    is_compared = known.speed is not None and known.speed.relation.independent
    change = motion.change if is_compared else None
    lateral = find_scalar(LATERAL, across, free, shows_left)
    longitudinal = find_scalar(LONGITUDINAL, change, free, shows_left)
    for choice in (lateral, longitudinal):
        if choice is not None and choice.sources[""].signal in sensors.other_axes:
            choice.doubt = choice.doubt or (
                "it is an axis of another accelerometer, which need not be an axis of the vehicle"
            )
    return [wheels, steering, yaw_rate, lateral, longitudinal], vehicle


def _yaw_rate(known: KnownMotion, free: Sequence[SeenSignal]) -> Choice | None:
    """Find the yaw rate by comparison with the gyroscope. Without a gyroscope, use that speed times
    yaw rate equals the lateral acceleration; the yaw rate is then known from the signal."""
    motion = known.motion
    turn = motion.turn
    if turn is None and motion.lateral is not None and motion.moving is not None:
        turn = motion.lateral / motion.moving
    choice = find_scalar(YAW_RATE, turn, free, known.shows_left)
    if motion.turn is None and turn is not None:
        found = _read(choice, free, YAW_RATE)
        turn = turn if found is None else found[0].x * found[1]
        known.motion = motion.with_channel("yaw_rate", turn)
    return choice


def _read(
    choice: Choice | None, free: Sequence[SeenSignal], quantity: ScalarQuantity
) -> tuple[SeenSignal, float] | None:
    """Return the signal of a choice that is sure, and its factor to SI with its sign; else None."""
    if choice is None or choice.doubt:
        return None
    source = choice.sources[""]
    candidate = candidate_of(source, free)
    factor = factor_of(source.unit or candidate.unit, quantity.dimension)
    return None if factor is None else (candidate, factor * source.sign)


def _wheels(sensors: Sensors) -> tuple[Choice | None, list[tuple[str, str, str]]]:
    wheels, known = sensors.wheels, sensors.reference
    if wheels is None:
        return None, []
    unit = stated_unit(wheels[0].unit, "speed")
    doubt = ""
    if known.speed is not None:
        mean = np.column_stack([c.smooth for c in wheels]).mean(axis=1)
        own = known.speed.candidate.smooth * known.speed.unit.factor
        found = relation(own, mean)
        if found.is_believed and found.low > 0.0:
            fitting = choose_unit(wheels[0].unit, "speed", 0.87 / found.high, 1.15 / found.low)
            if fitting is None:
                doubt = f"they do not fit {known.speed.candidate.path} in any unit"
            unit = fitting or unit
    if unit is None:
        return None, []
    choice, track = find_wheels(wheels, unit, unit.doubt or doubt, known.motion)
    text = "speed of the right wheels minus the left wheels, divided by the yaw rate"
    return choice, [] if track is None else [("track", f"{track:.2f}", text)]


def _steering_ratio(
    choice: Choice | None, free: Sequence[SeenSignal], known: KnownMotion
) -> list[tuple[str, str, str]]:
    """Return the steering ratio for the assumed wheelbase. Only the product of ratio and wheelbase
    is observable."""
    found, motion = _read(choice, free, STEERING), known.motion
    curvature, speed = motion.curvature, motion.speed
    if found is None or curvature is None or speed is None:
        return []
    metres = _turning_metres(found[0].smooth * found[1], curvature, speed)
    if metres is None:
        return []
    text = (
        f"the recording shows wheelbase times ratio, {metres:.1f} m; this ratio "
        f"is for a wheelbase of {WHEELBASE} m"
    )
    return [("steering_ratio", f"{metres / WHEELBASE:.1f}", text)]


def find_scalar(
    quantity: ScalarQuantity,
    reference: Array | None,
    candidates: Sequence[SeenSignal],
    shows_left: bool,
) -> Choice | None:
    """Return the signal that follows a reference best, with its unit and sign; None if no signal
    follows it.

    reference: (n,) in SI. shows_left: False if no signal shows which side is left.
    """
    usable = [
        c
        for c in candidates
        if c.may_be(quantity.dimension) and not c.is_constant and not c.is_switch
    ]
    if reference is None:
        return by_unit_and_name(quantity.name, quantity.dimension, usable)
    matches = []
    for c in usable:
        found = relation(reference, c.smooth)
        unit = unit_for(c.unit, quantity.dimension, found, quantity.gains)
        stated = unit is not None and unit.is_stated
        if found.is_believed_of(len(usable)) and found.explained >= (
            RELATED if stated else SAME_MOTION
        ):
            matches.append(Match(c, found, unit))
    matches = _ranked(matches, quantity)
    if not matches:
        why = f"chosen by unit and name only: it does not follow {quantity.words}"
        return by_unit_and_name(quantity.name, quantity.dimension, usable, why)
    best = matches[0]
    unit = best.unit or stated_unit(best.candidate.unit, quantity.dimension)
    if unit is None:
        return None
    evidence = f"{_words(best.relation)} with {quantity.words}{_gain_words(quantity, best)}"
    if best.candidate.sign_signal is not None:
        evidence += f"; its sign is in {best.candidate.sign_signal}"
    doubt = _doubt(best, matches[1:], quantity, shows_left)
    others = [
        Alternative({"": source_of(m.candidate, m.unit.name, m.relation.sign)}, _words(m.relation))
        for m in matches[1 : 1 + MAX_ALTERNATIVES]
        if m.unit is not None
    ]
    chosen = source_of(best.candidate, unit.name, best.relation.sign)
    return Choice(quantity.name, {"": chosen}, evidence, doubt, others)


def _ranked(matches: list[Match], quantity: ScalarQuantity) -> list[Match]:
    return sorted(
        matches,
        key=lambda m: (
            m.unit is None,
            not m.candidate.states(quantity.dimension),
            -m.relation.explained,
        ),
    )


def _doubt(best: Match, others: list[Match], quantity: ScalarQuantity, shows_left: bool) -> str:
    if best.unit is None:
        return (
            "its values are too large or too small for every unit: the scale in the database is "
            "wrong, or "
            "the signal is another quantity"
        )
    if best.unit.doubt:
        return best.unit.doubt
    if not best.candidate.states(quantity.dimension):
        rivals = [
            m for m in others if m.unit is not None and not is_better(best.relation, m.relation)
        ]
        if rivals:
            return f"{rivals[0].candidate.path} fits equally well, and no unit is stated"
        if best.relation.explained < 0.8:
            return "the database states no unit, and the signal has large changes that do not fit"
    if quantity.has_sides and not shows_left:
        return "no signal on this bus shows which side is left: its sign may be wrong"
    return ""


def _words(found: Relation) -> str:
    return f"correlation {found.correlation:+.2f}"


def _gain_words(quantity: ScalarQuantity, match: Match) -> str:
    if match.unit is None:
        return ""
    unit = f"in {match.unit.name} ({'stated' if match.unit.is_stated else 'found'})"
    if quantity is STEERING:  # its gain is under 'vehicle', from a fit with understeer
        return f", {unit}"
    return f", gain {match.relation.gain * match.unit.factor:.2f} {unit}"


def _turning_metres(angle: Array, curvature: Array, speed: Array) -> float | None:
    """Return wheelbase times steering ratio [m] by least squares: angle = L i curvature (1 + K v^2)
    + offset. None if the fit is poor."""
    rows = np.isfinite(angle) & np.isfinite(curvature) & np.isfinite(speed)
    if np.count_nonzero(rows) < 200:
        return None
    k, v = curvature[rows], speed[rows]
    known = np.column_stack([k, k * v * v, np.ones(len(k))])
    solution, *_ = np.linalg.lstsq(known, angle[rows], rcond=None)
    low, high = STEERING_METRES
    left = angle[rows] - known @ solution
    good = float(left.var()) < 0.2 * float(angle[rows].var()) and low < solution[0] < high
    return float(solution[0]) if good else None
