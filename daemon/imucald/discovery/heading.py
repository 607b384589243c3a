"""Find the heading, and use its direction of rotation to check the accelerometer's sign.

The course of every satellite receiver is clockwise. Some sensors output the negative specific force
(phones, and sensors of a "gravity vector"). Such a sensor seems to be mounted upside down and
backwards, which also fits speed, turns and gyroscope. The heading is the only signal on a bus that
shows the difference.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucald.config_check.motion import Motion, course_rate, shifted
from imucald.config_check.relation import DELAYS, Relation, relation
from imucald.discovery.candidates import SeenSignal
from imucald.discovery.evidence import RELATED, SAME_MOTION, stated_unit
from imucald.discovery.names import WHEELS, by_unit_and_name, hint
from imucald.discovery.proposal import Choice, Proposed, source_of
from imucald.discovery.reference import KnownMotion
from imucald.discovery.triads import BY_PLACES
from imucald.discovery.wheels import BY_TURNS, EXCHANGED, IN_ORDER
from imucald.mount.mirror import DOUBTED, REMEDY, SIDED, names_of, probability

GAIN = 1.5
"""Largest accepted gain ratio. It is between 1 (right unit) and 2 (wrong unit by a factor of
two). The varying delay of a receiver makes the gain too large."""


@dataclass(frozen=True, eq=False)
class HeadingFit:
    """An angle whose change is the yaw rate. relation: relation to clockwise rotation. delay:
    [ticks of 0.1 s]."""

    candidate: SeenSignal
    relation: Relation
    delay: int
    is_reversed: bool = False
    """True if the signs of the accelerometer's axes were reversed to agree with the heading."""

    @property
    def is_named(self) -> bool:
        """True if the name is that of a compass signal."""
        return hint("heading", self.candidate) is not None

    @property
    def is_like_a_compass(self) -> bool:
        """True if the name is that of a compass signal, or if the signal has no negative values, as
        a count from 0 to 360."""
        return self.is_named or self.candidate.least >= 0.0


def fit_heading(motion: Motion, candidates: Sequence[SeenSignal]) -> HeadingFit | None:
    """Return the angle whose change follows the yaw rate best, with its delay. None if no angle
    follows the yaw rate."""
    turn = motion.turn
    if turn is None:
        return None
    if motion.moving is not None:  # a receiver at rest has no course
        turn = np.where(np.isfinite(motion.moving), turn, np.nan)
    best: HeadingFit | None = None
    for c in candidates:
        if c.course is None or c.is_constant:
            continue
        clockwise = -course_rate(c.course)
        fits = (HeadingFit(c, relation(-turn, shifted(clockwise, d)), d) for d in DELAYS)
        one = max(fits, key=lambda f: f.relation.explained)
        found = one.relation
        # the delay of a receiver's fixes varies, which is noise in the change of its course
        share = RELATED if one.is_named else SAME_MOTION
        fitting = found.explained >= share and 1.0 / GAIN < found.gain < GAIN
        if found.is_believed and fitting and (best is None or found.z > best.relation.z):
            best = one
    return best


def heading_choice(
    fit: HeadingFit | None, motion: Motion, candidates: Sequence[SeenSignal]
) -> Choice | None:
    """Return the proposed heading. If no angle follows the turns, the heading is chosen by unit and
    name."""
    if fit is None:
        wide = []
        for c in candidates:
            unit = stated_unit(c.unit, "angle") if not c.is_constant else None
            if unit is not None and (c.largest - c.least) * unit.factor > np.pi:
                wide.append(c)
        why = "" if motion.turn is None else "its changes do not follow the turns in the recording"
        return by_unit_and_name("heading", "angle", wide, why)
    is_clockwise = fit.relation.sign > 0
    doubt = (
        ""
        if is_clockwise
        else (
            "a compass counts clockwise, but this signal does not; see "
            "the finding on the accelerometer"
        )
    )
    if fit.is_reversed and not fit.is_named:
        doubt = "the name does not show that it is a compass; see the finding on the accelerometer"
    late = f", {0.1 * fit.delay:.1f} s late" if fit.delay > 0 else ""
    sense = "clockwise" if is_clockwise else "counter-clockwise"
    return Choice(
        "heading",
        {"": source_of(fit.candidate, None, fit.relation.sign)},
        f"its change follows the yaw rate (correlation {fit.relation.correlation:+.2f}, "
        f"{sense}{late})",
        doubt,
    )


def doubt_what_is_turned(
    accelerometer: Choice, gyroscope: Choice | None, fit: HeadingFit | None
) -> None:
    """Add doubts if all signs of the gyroscope were reversed before the heading was used.

    The signs of the gyroscope were reversed to fit the accelerometer, so the heading tests both
    sensors together. If this reversal is uncertain, an agreement does not prove the signs of the
    accelerometer, and a disagreement does not prove that they are wrong.
    """
    if fit is None or gyroscope is None:
        return
    if not all(source.sign < 0 for source in gyroscope.sources.values()):
        return
    if fit.is_reversed or fit.relation.sign < 0:
        gyroscope.doubt = gyroscope.doubt or (
            f"its signs are set to fit the accelerometer, but {fit.candidate.path} turns "
            "counter-clockwise compared with both: perhaps an axis of the accelerometer "
            "has the wrong sign"
        )
    elif gyroscope.doubt:
        accelerometer.doubt = (
            f"{fit.candidate.path} is clockwise only with 'sign: -1' on the gyroscope, "
            "and that sign is uncertain. If the gyroscope needs no 'sign: -1', this "
            "sensor outputs minus the specific force: set 'sign: -1' on all three axes"
        )


def hold_against_heading(
    known: KnownMotion, accelerometer: Choice, fit: HeadingFit | None
) -> HeadingFit | None:
    """Reverse the accelerometer and all results from it if a compass shows that the accelerometer
    is reversed.

    Returns the fit with its new direction of rotation. If the signal's name is not that of a
    compass, all signals with left and right get a doubt.
    """
    if fit is None or fit.relation.sign > 0:
        return fit
    known.shows_left = fit.is_named
    if not fit.is_like_a_compass:
        accelerometer.doubt = (
            f"{fit.candidate.path} turns counter-clockwise compared with this sensor. If "
            f"{fit.candidate.path} is a compass course, the sensor outputs minus the "
            "specific force: set 'sign: -1' on all three axes"
        )
        return fit
    accelerometer.sources = {
        axis: replace(source, sign=-source.sign) for axis, source in accelerometer.sources.items()
    }
    accelerometer.doubt = (
        "this sensor seems to output minus the specific force, so 'sign: -1' is set: without it, "
        "the sensor and the course turn in opposite directions. Check it at rest: if the axis "
        "that points up shows +1 g without 'sign: -1', remove 'sign: -1'"
    )
    known.motion = known.motion.turned("accel", -np.eye(3))
    mirrored = replace(fit.relation, correlation=-fit.relation.correlation)
    return replace(fit, relation=mirrored, is_reversed=True)


WITH_IT = "its sign depends on the signs of the accelerometer, which are unsure"


def hold_against_usual_signs(choices: Sequence[Choice], heading: HeadingFit | None) -> None:
    """Add a doubt to an accelerometer that may be mirrored. Reverse the accelerometer if a mirrored
    accelerometer is more likely than wrong signs of all other signals.

    If a compass is on the bus, nothing is changed, because the compass has already decided.
    """
    by_name = {choice.quantity: choice for choice in choices}
    accelerometer = by_name.get("accelerometer")
    if accelerometer is None or len(accelerometer.sources) < 3 or accelerometer.doubt:
        return
    if heading is not None and heading.is_like_a_compass:
        return
    turned = _turned(by_name)
    by_places = BY_PLACES in accelerometer.evidence
    likely = probability(turned, by_places)
    if likely < DOUBTED:
        return
    names = names_of(turned)
    for name in SIDED:
        if name in turned:
            by_name[name].doubt = WITH_IT
    # if names do not show the axes, the database may not use the usual signs either
    if likely <= 0.5 or by_places or not any(turned.get(name) for name in SIDED):
        accelerometer.doubt = f"with the present signs, {names} would need 'sign: -1': {REMEDY}"
        return
    accelerometer.doubt = (
        f"'sign: -1' is set on all axes, since {names} would need 'sign: -1' otherwise: the sensor "
        "outputs minus the specific force, or its axes are left-handed (probability "
        f"{100 * likely:.0f} %). Check it at rest: if the axis that points up does not show "
        "+1 g, remove 'sign: -1' here"
    )
    accelerometer.sources = {k: _other(s) for k, s in accelerometer.sources.items()}
    for name in SIDED:
        if name in turned:
            choice = by_name[name]
            choice.sources = {k: _other(s) for k, s in choice.sources.items()}
            choice.evidence += "; its sign fits the accelerometer with 'sign: -1'"
    _exchange_wheels(by_name.get("wheel_speeds"))


def doubt_both_sensors(choices: Sequence[Choice], contradiction: str) -> None:
    """Add a doubt to an accelerometer and a gyroscope that contradict each other, and to all signs
    that follow from them."""
    for choice in choices:
        if choice.quantity == "gyroscope":
            choice.doubt = contradiction
        elif choice.quantity == "accelerometer":
            choice.doubt = choice.doubt or contradiction
        elif choice.quantity in SIDED or BY_TURNS in choice.evidence:
            choice.doubt = choice.doubt or WITH_IT


def _exchange_wheels(wheels: Choice | None) -> None:
    if wheels is not None and wheels.doubt == EXCHANGED:
        wheels.doubt = ""
    elif wheels is not None and BY_TURNS in wheels.evidence:
        fl, fr, rl, rr = (wheels.sources[wheel] for wheel in WHEELS)
        wheels.sources = dict(zip(WHEELS, (fr, fl, rr, rl), strict=True))


def _other(source: Proposed) -> Proposed:
    return replace(source, sign=-source.sign)


def _has_sign_bit(choice: Choice) -> bool:
    return any(source.sign_signal is not None for source in choice.sources.values())


def _turned(by_name: dict[str, Choice]) -> dict[str, bool]:
    """Return True or False for each signal with left and right whose sign is known: whether its
    sign must be inverted."""
    turned = {}
    for name in ("gyroscope", *SIDED):
        choice = by_name.get(name)
        if choice is not None and choice.is_sure and not _has_sign_bit(choice):
            turned[name] = all(source.sign < 0 for source in choice.sources.values())
    wheels = by_name.get("wheel_speeds")
    if wheels is not None and IN_ORDER in wheels.evidence:
        turned["wheel_speeds"] = False
    elif wheels is not None and wheels.doubt == EXCHANGED:
        turned["wheel_speeds"] = True
    return turned
