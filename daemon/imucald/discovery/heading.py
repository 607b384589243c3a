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
from imucald.discovery.evidence import GAINS, RELATED, SAME_MOTION, stated_unit
from imucald.discovery.names import by_unit_and_name, hint
from imucald.discovery.proposal import Choice, source_of
from imucald.discovery.reference import KnownMotion


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
        fitting = found.explained >= share and GAINS[0] < found.gain < GAINS[1]
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
