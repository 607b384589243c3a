"""Find the signals of turns (yaw rate, steering, accelerations, wheels) and vehicle dimensions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from imucald.config_check.relation import relation
from imucald.core.arrays import Array
from imucald.discovery.candidates import SeenSignal
from imucald.discovery.evidence import choose_unit, factor_of, stated_unit
from imucald.discovery.proposal import Choice, candidate_of
from imucald.discovery.scalars import (
    LATERAL,
    LONGITUDINAL,
    STEERING,
    YAW_RATE,
    find_scalar,
)
from imucald.discovery.sensors import Sensors
from imucald.discovery.wheels import find_wheels

OTHER_AXIS = "it is an axis of another accelerometer, which need not be an axis of the vehicle"
WHEELBASE = 2.7
"""Default wheelbase of the configuration [m]."""


class Turning:
    """Signals of turns. vehicle: (key, value, evidence) of vehicle data that these signals show."""

    def __init__(self, sensors: Sensors) -> None:
        self._sensors = sensors
        self.reference = sensors.reference
        self.vehicle: list[tuple[str, str, str]] = []

    def choices(self, free: Sequence[SeenSignal]) -> Iterator[Choice | None]:
        """Yield choices of wheels, steering, yaw rate and accelerations, in the order of the
        configuration."""
        known = self.reference
        yaw_rate = self._yaw_rate(free)
        motion, shows_left = known.motion, known.shows_left
        yield self._wheels()
        steering = find_scalar(STEERING, motion.curvature, free, shows_left)
        yield steering
        if steering is not None:
            self._note_steering(steering, free)
        yield yaw_rate
        v, turn = motion.moving, motion.turn
        lateral = None if v is None or turn is None else v * turn
        is_compared = known.speed is not None and known.speed.relation.independent
        yield self._of_the_vehicle(find_scalar(LATERAL, lateral, free, shows_left))
        change = motion.change if is_compared else None
        yield self._of_the_vehicle(find_scalar(LONGITUDINAL, change, free))

    def _of_the_vehicle(self, choice: Choice | None) -> Choice | None:
        """Add a doubt to an acceleration that is an axis of another accelerometer."""
        if choice is not None and choice.sources[""].signal in self._sensors.other_axes:
            choice.doubt = choice.doubt or OTHER_AXIS
        return choice

    def _yaw_rate(self, free: Sequence[SeenSignal]) -> Choice | None:
        """Find the yaw rate by comparison with the gyroscope. Without a gyroscope, use that speed
        times yaw rate equals the lateral acceleration.
        """
        known = self.reference
        motion, shows_left = known.motion, known.shows_left
        if motion.turn is None and motion.lateral is not None and motion.moving is not None:
            turn = motion.lateral / motion.moving
            choice = find_scalar(YAW_RATE, turn, free, shows_left)
            known.motion = motion.with_channel("yaw_rate", _turn_of(choice, free, turn))
            return choice
        return find_scalar(YAW_RATE, motion.turn, free, shows_left)

    def _wheels(self) -> Choice | None:
        wheels, reference = self._sensors.wheels, self.reference
        if wheels is None:
            return None
        unit = stated_unit(wheels[0].unit, "speed")
        doubt = ""
        mean = np.column_stack([c.smooth for c in wheels]).mean(axis=1)
        speed = reference.speed
        if speed is not None:
            own = speed.candidate.smooth * speed.unit.factor
            found = relation(own, mean)
            if found.is_believed and found.low > 0.0:
                fitting = choose_unit(wheels[0].unit, "speed", 0.87 / found.high, 1.15 / found.low)
                if fitting is None:
                    doubt = f"they do not fit {speed.candidate.path} in any unit"
                unit = fitting or unit
        if unit is None:
            return None
        doubt = unit.doubt or doubt
        choice, track = find_wheels(wheels, unit, doubt, reference.motion)
        if track is not None:
            self.vehicle.append(
                (
                    "track",
                    f"{track:.2f}",
                    "speed of the right wheels minus the left wheels, divided by the yaw rate",
                )
            )
        return choice

    def _note_steering(self, choice: Choice, free: Sequence[SeenSignal]) -> None:
        """Note the steering ratio for the assumed wheelbase. Only the product of ratio and
        wheelbase is observable."""
        source = choice.sources[""]
        candidate = candidate_of(source, free)
        factor = factor_of(source.unit or candidate.unit, "angle")
        curvature, speed = self.reference.motion.curvature, self.reference.motion.speed
        if factor is None or curvature is None or speed is None or choice.doubt:
            return
        metres = _turning_metres(candidate.smooth * factor * source.sign, curvature, speed)
        if metres is not None:
            text = (
                f"the recording shows wheelbase times ratio, {metres:.1f} m; this ratio "
                f"is for a wheelbase of {WHEELBASE} m"
            )
            self.vehicle.append(("steering_ratio", f"{metres / WHEELBASE:.1f}", text))


def _turn_of(choice: Choice | None, free: Sequence[SeenSignal], otherwise: Array) -> Array:
    """Return the yaw rate that was found, else `otherwise`, the yaw rate from the accelerometer."""
    if choice is not None and choice.is_sure:
        source = choice.sources[""]
        candidate = candidate_of(source, free)
        factor = factor_of(source.unit or candidate.unit, "angular_rate")
        if factor is not None:
            return candidate.x * (factor * source.sign)
    return otherwise


def _turning_metres(angle: Array, curvature: Array, speed: Array) -> float | None:
    """Return wheelbase times steering ratio [m] by least squares: angle = L i curvature (1 + K v^2)
    + offset. None if the fit is poor."""
    rows = np.isfinite(angle) & np.isfinite(curvature) & np.isfinite(speed)
    if np.count_nonzero(rows) < 200:
        return None
    k, v = curvature[rows], speed[rows]
    known = np.column_stack([k, k * v * v, np.ones(len(k))])
    solution, *_ = np.linalg.lstsq(known, angle[rows], rcond=None)
    left = angle[rows] - known @ solution
    good = float(left.var()) < 0.2 * float(angle[rows].var()) and 15.0 < solution[0] < 130.0
    return float(solution[0]) if good else None
