"""What the vehicle did: the reference that signals are held against.

Only physics ties signals together here: an accelerometer shows the change of speed along the
vehicle and speed times yaw rate across it. Where a sensor of three axes is level follows from
gravity, forward from the change of speed, left from both (axes are taken as right-handed).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucald.config_check.motion import SMOOTH, shifted
from imucald.config_check.relation import Relation, relation
from imucald.core.arrays import Array
from imucald.discovery.candidates import SeenSignal
from imucald.discovery.evidence import COMMON_UNITS, UnitChoice, choose_unit, factor_of
from imucald.discovery.triads import Triad
from imucald.motion.ticks import TICK_RATE

DELAYS = range(-6, 26)
"""Ticks by which speed and course may be late: OBD-II makes up to a second and a half; a receiver
that smooths, is asked once a second, and whose answer waits, two and a half."""
GAIN_TOLERANCE = 1.25
"""Squat, slope and tyres change a gain by so much (measured and simulated vehicles: 0.8 to 1.2)."""
MOVING = 3.0
"""Speed from which turns are compared [m/s]: slower ones may be reversing, where left is right in
whatever goes with an unsigned speed, and curvature is a division by nearly nothing."""
LEAST_SPEED_BITS = 7


@dataclass(frozen=True, eq=False)
class SpeedFit:
    """A speed against the accelerometer. delay [ticks]; relation of the accelerometer to it."""

    candidate: SeenSignal
    unit: UnitChoice
    relation: Relation
    delay: int = 0
    forward: Array | None = None
    """(3,) unit vector in the accelerometer's axes."""

    @property
    def is_believed(self) -> bool:
        """Whether its changes show in the accelerometer."""
        return self.relation.is_believed

    @property
    def speed(self) -> Array:
        """(n,) [m/s], brought to the accelerometer's time."""
        return shifted(self.candidate.smooth * self.unit.factor, self.delay)

    @property
    def change(self) -> Array:
        """(n,) [m/s^2]."""
        return change_of(self.speed)

    @property
    def moving(self) -> Array:
        """(n,) the speed where it is above MOVING, else NaN."""
        return moving(self.speed)


@dataclass(eq=False)
class KnownMotion:
    """The vehicle's motion as far as it is known; arrays (n,) in SI.

    along, lateral: acceleration forward and to the left as the accelerometer shows it. turn: yaw
    rate, left positive.
    """

    accelerometer: Triad | None = None
    up: Array | None = None
    speed: SpeedFit | None = None
    along: Array | None = None
    lateral: Array | None = None
    turn: Array | None = None
    sides_from: str = ""
    """What separates left from right."""

    @property
    def forward(self) -> Array | None:
        """(3,) in the accelerometer's axes."""
        return None if self.speed is None else self.speed.forward

    def set_lateral(self) -> None:
        """Left from up and forward, once both are known."""
        if self.accelerometer is None or self.up is None or self.forward is None:
            return
        self.along = self.accelerometer.smooth @ self.forward
        self.lateral = self.accelerometer.smooth @ np.cross(self.up, self.forward)
        self.sides_from = "the axes of the accelerometer, if they are right-handed"

    @property
    def curvature(self) -> Array | None:
        """(n,) yaw rate over speed [1/m], NaN below MOVING."""
        if self.turn is None or self.speed is None:
            return None
        return self.turn / self.speed.moving


def moving(speed: Array) -> Array:
    """A speed (n,) [m/s] where it is above MOVING, else NaN."""
    return np.where(np.abs(speed) > MOVING, speed, np.nan)


def change_of(speed: Array) -> Array:
    """Derivative of a smoothed (n,) speed over the length of its window."""
    half = SMOOTH // 2
    return (shifted(speed, half) - shifted(speed, -half)) * (TICK_RATE / (2 * half))


def direction_up(accelerometer: Triad) -> Array:
    """(3,) unit vector of the mean specific force: up, within slopes and manoeuvres."""
    mean = np.nanmean(accelerometer.smooth, axis=0)
    return np.asarray(mean / np.linalg.norm(mean))


def speed_candidates(candidates: Sequence[SeenSignal]) -> list[SeenSignal]:
    """Signals whose unit allows a speed and that move as one may."""
    return [
        c
        for c in candidates
        if c.may_be("speed")
        and not c.is_constant
        and c.signal.length >= LEAST_SPEED_BITS
        and (c.states("speed") or not c.levels)
    ]


def speed_against_accelerometer(c: SeenSignal, triad: Triad, up: Array) -> SpeedFit | None:
    """How the changes of a speed show in the accelerometer, and in which unit; None: not at all."""
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
        shown = Relation()  # a stated unit that contradicts the data: not believed
    return SpeedFit(c, unit, shown, delay, forward)


def response(c: SeenSignal, triad: Triad, up: Array) -> tuple[Relation, int, Array] | None:
    """Acceleration in a level plane [m/s^2] for one of a speed's unit per second.

    Returns the relation, the delay of the speed [ticks], and forward (3,); None: hardly any.
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
    """A candidate's own unit, where it is one of the dimension."""
    factor = factor_of(c.unit, dimension) if c.states(dimension) else None
    return None if factor is None else UnitChoice(c.unit, factor, True)


def unit_for(
    c: SeenSignal, dimension: str, found: Relation, tolerance: float = GAIN_TOLERANCE
) -> UnitChoice | None:
    """The unit in which a signal is its SI reference, give or take a tolerance."""
    if not found.low > 0.0:
        return None
    low, high = 1.0 / (found.high * tolerance), tolerance / found.low
    return choose_unit(c.unit, dimension, low, high, COMMON_UNITS[dimension])


def level_axes(up: Array) -> Array:
    """(2, 3) two unit vectors at right angles to up and to each other."""
    start = np.eye(3)[int(np.argmin(np.abs(up)))]
    first = np.cross(up, start)
    first /= np.linalg.norm(first)
    return np.vstack([first, np.cross(up, first)])


def _explained(accel: Array, change: Array) -> float:
    """Part of the change of speed's variance that level acceleration explains."""
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
    """(2,) response of level acceleration to one of `known`."""
    rows = np.isfinite(known) & np.isfinite(accel).all(axis=1)
    x = known[rows] - known[rows].mean()
    return np.asarray((accel[rows] - accel[rows].mean(axis=0)).T @ x / (x @ x))
