"""The vehicle's motion, as the reference with which signals are compared.

The module uses only physical relations between signals. The forward acceleration is the change of
speed, and the acceleration to the left is speed times yaw rate. For a three-axis sensor, gravity
gives the direction up, and the change of speed gives the direction forward. Up and forward give the
direction left (axes are assumed to be right-handed).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucald.config_check.motion import change_of, moving, shifted
from imucald.config_check.relation import Relation, relation
from imucald.core.arrays import Array
from imucald.discovery.candidates import SeenSignal
from imucald.discovery.evidence import COMMON_UNITS, UnitChoice, choose_unit, factor_of
from imucald.discovery.triads import Triad

DELAYS = range(-6, 26)
"""Possible delays of speed and course [ticks of 0.1 s].

OBD-II causes up to 1.5 s. A satellite receiver causes up to 2.5 s if it smooths its values and is
asked once per second."""
GAIN_TOLERANCE = 1.25
"""Largest factor by which squat, slope and tyres change a gain. Measured and simulated vehicles
have gains of 0.8 to 1.2."""
LEAST_SPEED_BITS = 7


@dataclass(frozen=True, eq=False)
class SpeedFit:
    """A speed compared with the accelerometer. delay: delay of the speed [ticks of 0.1 s].
    relation: relation to the accelerometer."""

    candidate: SeenSignal
    unit: UnitChoice
    relation: Relation
    delay: int = 0
    forward: Array | None = None
    """Direction forward: unit vector (3,) in the accelerometer's axes."""

    @property
    def is_believed(self) -> bool:
        """True if the changes of the speed certainly appear in the accelerometer."""
        return self.relation.is_believed

    @property
    def speed(self) -> Array:
        """The speed (n,) [m/s] without its delay."""
        return shifted(self.candidate.smooth * self.unit.factor, self.delay)

    @property
    def change(self) -> Array:
        """The change of speed (n,) [m/s^2]."""
        return change_of(self.speed)

    @property
    def moving(self) -> Array:
        """The speed (n,) [m/s]; NaN where it is not above MOVING."""
        return moving(self.speed)


@dataclass(eq=False)
class KnownMotion:
    """The known part of the vehicle's motion. Arrays are (n,) in SI.

    along, lateral: acceleration forward and to the left, from the accelerometer. turn: yaw rate,
    positive to the left. up: (3,) direction up in the accelerometer's axes.
    """

    accelerometer: Triad | None = None
    up: Array | None = None
    speed: SpeedFit | None = None
    along: Array | None = None
    lateral: Array | None = None
    turn: Array | None = None
    sides_from: str = ""
    """Text with the evidence that distinguishes left from right; empty if there is none."""

    @property
    def forward(self) -> Array | None:
        """Direction forward (3,) in the accelerometer's axes."""
        return None if self.speed is None else self.speed.forward

    def set_lateral(self) -> None:
        """Compute the forward and the lateral acceleration from the directions up and forward, if
        both are known."""
        if self.accelerometer is None or self.up is None or self.forward is None:
            return
        self.along = self.accelerometer.smooth @ self.forward
        self.lateral = self.accelerometer.smooth @ np.cross(self.up, self.forward)
        self.sides_from = "the axes of the accelerometer, if they are right-handed"

    @property
    def curvature(self) -> Array | None:
        """Curvature (n,) [1/m]: yaw rate divided by speed, NaN below MOVING."""
        if self.turn is None or self.speed is None:
            return None
        return self.turn / self.speed.moving


def direction_up(accelerometer: Triad) -> Array:
    """Return the direction up: the unit vector (3,) of the mean specific force. Slopes cause an
    error."""
    mean = np.nanmean(accelerometer.smooth, axis=0)
    return np.asarray(mean / np.linalg.norm(mean))


def speed_candidates(candidates: Sequence[SeenSignal]) -> list[SeenSignal]:
    """Return the signals whose unit and values are possible for a speed."""
    return [
        c
        for c in candidates
        if c.may_be("speed")
        and not c.is_constant
        and c.signal.length >= LEAST_SPEED_BITS
        and (c.states("speed") or not c.levels)
    ]


def speed_against_accelerometer(c: SeenSignal, triad: Triad, up: Array) -> SpeedFit | None:
    """Compare the changes of a speed with the accelerometer, and find the unit of the speed. None
    if the accelerometer does not show the changes."""
    found = response(c, triad, up)
    if found is None:
        return None
    shown, delay, forward = found
    low, high = shown.low / GAIN_TOLERANCE, shown.high * GAIN_TOLERANCE
    unit = choose_unit(c.unit, "speed", low, high)
    if unit is None:
        unit = stated_unit(c, "speed")
        if unit is None:
            return None
        shown = Relation()  # the stated unit contradicts the data, so it is ignored
    return SpeedFit(c, unit, shown, delay, forward)


def response(c: SeenSignal, triad: Triad, up: Array) -> tuple[Relation, int, Array] | None:
    """Compare the horizontal acceleration with the change of a speed signal.

    Returns the relation ([m/s^2] per unit of speed change per second), the delay of the speed
    [ticks of 0.1 s], and the direction forward (3,). None if the relation is too weak.
    """
    level = level_axes(up)
    accel = triad.smooth @ level.T
    change = change_of(c.smooth)
    best, at = 0.0, 0
    for delay in range(DELAYS.start, DELAYS.stop, 3):
        part = _explained(accel, shifted(change, delay))
        if part > best:
            best, at = part, delay
    if best < 0.02:
        return None
    for delay in range(at - 2, at + 3):
        part = _explained(accel, shifted(change, delay))
        if part > best:
            best, at = part, delay
    moved = shifted(change, at)
    along = _least_squares(moved, accel)
    size = float(np.linalg.norm(along))
    if not size > 0.0:
        return None
    return relation(moved, accel @ (along / size)), at, (along / size) @ level


def stated_unit(c: SeenSignal, dimension: str) -> UnitChoice | None:
    """Return a candidate's stated unit; None if it is not a unit of this dimension."""
    factor = factor_of(c.unit, dimension) if c.states(dimension) else None
    return None if factor is None else UnitChoice(c.unit, factor, True)


def unit_for(
    c: SeenSignal, dimension: str, found: Relation, tolerance: float = GAIN_TOLERANCE
) -> UnitChoice | None:
    """Return the unit in which a signal equals its SI reference within a tolerance, or None."""
    if not found.low > 0.0:
        return None
    low, high = 1.0 / (found.high * tolerance), tolerance / found.low
    return choose_unit(c.unit, dimension, low, high, COMMON_UNITS[dimension])


def level_axes(up: Array) -> Array:
    """Return two unit vectors (2, 3) that are orthogonal to up and to each other."""
    start = np.eye(3)[int(np.argmin(np.abs(up)))]
    first = np.cross(up, start)
    first /= np.linalg.norm(first)
    return np.vstack([first, np.cross(up, first)])


def _explained(accel: Array, change: Array) -> float:
    """Return the share of the variance of speed changes that the horizontal acceleration
    explains."""
    rows = np.isfinite(change) & np.isfinite(accel).all(axis=1)
    if np.count_nonzero(rows) < 50:
        return 0.0
    y = change[rows] - change[rows].mean()
    a = accel[rows] - accel[rows].mean(axis=0)
    total = float(y @ y)
    if not total > 0.0:
        return 0.0
    return float((a.T @ y) @ np.linalg.pinv(a.T @ a) @ (a.T @ y)) / total


def _least_squares(known: Array, accel: Array) -> Array:
    """Return the response (2,) of the horizontal acceleration to `known`."""
    rows = np.isfinite(known) & np.isfinite(accel).all(axis=1)
    x = known[rows] - known[rows].mean()
    return np.asarray((accel[rows] - accel[rows].mean(axis=0)).T @ x / (x @ x))
