"""Find single signals that follow the vehicle's motion: yaw rate, accelerations, steering.

Each quantity has a reference from other signals, and a gain that is known from physics. Reference
and gain determine the sign and the unit of the signal.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from imucald.config_check.relation import Relation, is_better, relation
from imucald.core.arrays import Array
from imucald.discovery.candidates import SeenSignal
from imucald.discovery.evidence import (
    RELATED,
    SAME_MOTION,
    UnitChoice,
    choose_unit,
    stated_unit,
    unit_for,
)
from imucald.discovery.names import by_unit_and_name
from imucald.discovery.proposal import MAX_ALTERNATIVES, Alternative, Choice, source_of

STEERING_METRES = (15.0, 130.0)
"""Range of wheelbase times steering ratio [m]. The lower limit is half the value of a small car
with a quick rack (2.4 m x 12). The upper limit is the value of a lorry (6 m x 20)."""


@dataclass(frozen=True, eq=False)
class Match:
    """The comparison of a candidate with a reference."""

    candidate: SeenSignal
    relation: Relation
    unit: UnitChoice | None


@dataclass(frozen=True)
class ScalarQuantity:
    """A quantity of a single signal. unit: function that finds the unit of a signal from its
    relation to the reference."""

    name: str
    dimension: str
    words: str
    """Text that describes the reference, for the evidence."""
    unit: Callable[[SeenSignal, Relation], UnitChoice | None]


def _by_gain(dimension: str) -> Callable[[SeenSignal, Relation], UnitChoice | None]:
    return lambda c, found: unit_for(c.unit, dimension, found)


def _steering_unit(c: SeenSignal, found: Relation) -> UnitChoice | None:
    """Return the unit of the angle in which wheelbase times steering ratio is plausible, or
    None."""
    if not found.low > 0.0:
        return None
    low, high = STEERING_METRES
    middle = found.gain
    return choose_unit(c.unit, "angle", low / middle, high / middle)


YAW_RATE = ScalarQuantity("yaw_rate", "angular_rate", "the yaw rate", _by_gain("angular_rate"))
LATERAL = ScalarQuantity(
    "lateral_acceleration", "acceleration", "speed times yaw rate", _by_gain("acceleration")
)
LONGITUDINAL = ScalarQuantity(
    "longitudinal_acceleration", "acceleration", "the change of speed", _by_gain("acceleration")
)
STEERING = ScalarQuantity("steering_wheel_angle", "angle", "the curvature", _steering_unit)


def find_scalar(
    quantity: ScalarQuantity,
    reference: Array | None,
    candidates: Sequence[SeenSignal],
    shows_left: bool = True,
) -> Choice | None:
    """Return the signal that follows a reference best, with its unit and sign; None if no signal
    follows it.

    shows_left: False if the quantity has a left and right side, and no signal shows which is left.
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
        unit = quantity.unit(c, found)
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
    """Sort matches: fitting units first, then stated units, then the strongest relation."""
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
    if not shows_left:
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
