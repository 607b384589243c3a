"""The known part of the vehicle's motion, with which signals are compared, and its speed.

Only physical relations between signals are used. The forward acceleration is the change of speed,
and the acceleration to the left is speed times yaw rate. For a three-axis sensor, gravity gives the
direction up, and the change of speed gives the direction forward. Up and forward give the direction
left (axes are assumed to be right-handed).

A speedometer may show up to 10 % plus 4 km/h too much (UN Regulation 39). The changes of its speed
appear in the accelerometer as clearly as the changes of the true speed. Only the wheel speeds show
which of the speeds is the true speed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from imucald.config_check.motion import Motion, change_of, speed_ratio
from imucald.config_check.relation import Relation, is_better, response
from imucald.core.arrays import Array
from imucald.discovery.candidates import MEASURED_BITS, SeenSignal
from imucald.discovery.evidence import (
    GAIN_TOLERANCE,
    SAME_MOTION,
    UnitChoice,
    choose_unit,
    stated_unit,
)
from imucald.discovery.names import hint
from imucald.discovery.triads import Triad

NEAR_WHEELS = 0.04
"""Largest relative difference between a speed and the mean wheel speed (worn and wrong tyres,
slip)."""
ONE_UNIT = 0.2
"""Largest relative difference between a speed and the wheel speeds at which both have the same
unit."""


@dataclass(frozen=True, eq=False)
class SpeedFit:
    """A speed compared with the accelerometer. delay: delay of the speed [ticks of 0.1 s].
    relation: relation to the accelerometer. forward: direction forward (3,) in its axes."""

    candidate: SeenSignal
    unit: UnitChoice
    relation: Relation
    delay: int = 0
    forward: Array | None = None

    @property
    def is_believed(self) -> bool:
        """True if the changes of the speed certainly appear in the accelerometer."""
        return self.relation.is_believed


@dataclass(eq=False)
class KnownMotion:
    """The known part of the vehicle's motion. motion: the chosen signals in SI, without delays.
    shows_left: True if there is evidence which side is left."""

    motion: Motion = field(default_factory=lambda: Motion({}, planar=False))
    accelerometer: Triad | None = None
    speed: SpeedFit | None = None
    shows_left: bool = False

    def set_speed(self, fit: SpeedFit) -> None:
        """Use a speed, and the direction forward that it shows."""
        self.speed = fit
        own = fit.candidate.x * fit.unit.factor
        self.motion = self.motion.with_channel("speed", own)
        if fit.forward is not None:
            self.motion = self.motion.facing(fit.forward, fit.delay)
            self.shows_left = True  # if the axes of the accelerometer are right-handed


def of_accelerometer(triad: Triad) -> KnownMotion:
    """Return what an accelerometer alone shows."""
    return KnownMotion(Motion({"accel": triad.ticks}, planar=False), triad)


def speed_candidates(candidates: Sequence[SeenSignal]) -> list[SeenSignal]:
    """Return the signals whose unit and values are possible for a speed."""
    return [
        c
        for c in candidates
        if c.may_be("speed")
        and not c.is_constant
        and c.signal.length >= MEASURED_BITS
        and (c.states("speed") or not c.levels)
    ]


def speed_against_accelerometer(c: SeenSignal, motion: Motion) -> SpeedFit | None:
    """Compare the changes of a speed with the accelerometer, and find the unit of the speed. None
    if the accelerometer does not show the changes."""
    if motion.accel is None or motion.up is None:
        return None
    found = response(motion.accel, motion.up, change_of(c.smooth))
    if found is None:
        return None
    shown = found.relation
    low, high = shown.low / GAIN_TOLERANCE, shown.high * GAIN_TOLERANCE
    unit = choose_unit(c.unit, "speed", low, high)
    if unit is None:
        unit = stated_unit(c.unit, "speed")
        if unit is None:
            return None
        shown = Relation()  # the stated unit contradicts the data, so it is ignored
    return SpeedFit(c, unit, shown, found.delay, found.forward)


def wheel_mean(wheels: Sequence[SeenSignal] | None) -> Array | None:
    """Return the mean wheel speed (n,) [m/s]; None if the wheels state no unit."""
    unit = stated_unit(wheels[0].unit, "speed") if wheels else None
    if unit is None or wheels is None:
        return None
    return np.asarray(np.column_stack([c.smooth for c in wheels]).mean(axis=1) * unit.factor)


def apart_from(fit: SpeedFit, mean: Array) -> float:
    """Return the relative difference between a speed and the mean wheel speed."""
    ratio = speed_ratio(fit.candidate.smooth * fit.unit.factor, mean)
    return np.inf if ratio is None else abs(ratio - 1.0)


def best_first(fits: list[SpeedFit], mean: Array | None) -> list[SpeedFit]:
    """Sort speeds: speeds near the wheel speeds first, then stated units, then the best explanation
    of the accelerations.

    If two speeds differ only by chance, a speed with a name of a speed is first, then the speed
    with the shorter cycle. Signals without a unit are kept only if they explain most of the motion.
    """
    fits = [f for f in fits if f.unit.is_stated or f.relation.explained >= SAME_MOTION]

    def rank(f: SpeedFit) -> tuple[bool, bool]:
        return mean is not None and apart_from(f, mean) > NEAR_WHEELS, not f.unit.is_stated

    fits = sorted(fits, key=lambda f: (*rank(f), -f.relation.explained))
    if not fits:
        return fits
    first = fits[0]
    equal = [
        f for f in fits if rank(f) == rank(first) and not is_better(first.relation, f.relation)
    ]
    equal.sort(key=lambda f: (hint("speed", f.candidate) is None, f.candidate.cycle))
    return equal + [f for f in fits if f not in equal]


def speed_doubt(fits: list[SpeedFit], mean: Array | None) -> str:
    """Return the reason why the first of several speeds is not sure; empty if it is sure."""
    best = fits[0]
    if best.unit.doubt:
        return best.unit.doubt
    if mean is not None:
        apart = apart_from(best, mean)
        if apart > ONE_UNIT:
            return "the wheel speeds differ from it"
        return "" if best.unit.is_stated or apart < NEAR_WHEELS else "no unit is stated"
    if not best.unit.is_stated and best.relation.explained < SAME_MOTION:
        return "the database states no unit, and half of the accelerations do not fit"
    own = np.abs(best.candidate.smooth * best.unit.factor)
    for other in fits[1:]:
        apart = apart_from(other, own)
        if NEAR_WHEELS < apart < 2.0 * ONE_UNIT and not is_better(best.relation, other.relation):
            return f"{other.candidate.path} differs from it by {100 * apart:.0f} % and fits as well"
    return ""
