"""The unknowns of the joint estimate, with unit, prior and source.

All unknowns are about the working axes, in which force and rate are nearly along the vehicle's
axes:

    force = (1 + E) true force + g b      E = [phi x] + e
    rate  = (1 + C) true rate             C = [phi x] + [(0, 0, eps_z) x] + tilt of column z
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from imucald.core.arrays import Array
from imucald.core.rotations import Matrix3
from imucald.core.samples import GRAVITY
from imucald.drive.unknown_speed import Steered
from imucald.mount.estimate import SentDeviations
from imucald.mount.priors import CROSS_AXIS

OFF: Final = ((0, 1), (1, 0), (0, 2), (2, 0), (1, 2), (2, 1))
"""Places of the cross-axis terms e in a matrix."""
TURN: Final = {
    (0, 1): (2, -1.0), (1, 0): (2, 1.0), (0, 2): (1, 1.0), (2, 0): (1, -1.0), (1, 2): (0, -1.0),
    (2, 1): (0, 1.0),
}  # fmt: skip
"""Axis and sign of the rotation phi at each place of [phi x]."""
PHI, CROSS, ZERO, EPS, CROWN = slice(0, 3), slice(3, 9), slice(9, 11), slice(11, 14), 14
NO_TURN: Final = np.zeros(3)
UNKNOWNS = 15
MOST_GAIN = 1.45
"""Largest gain of a sensor's matrix along any direction: four deviations of cross-axis terms of 8
%, the largest size that is tested, in two places.
"""
SLOPE, SLOPE_M = 0.02, 400.0
"""Slope of a road (tangent), and metres after which the slope is independent: twice its correlation
length.
"""
FREE = 10.0
"""Prior deviation of an unknown rotation [rad]."""


class OtherSignals(NamedTuple):
    """Signals besides the accelerometer.

    gyro: the sensor has a gyroscope. Without one, the vertical is not carried and slopes are noise
    of the level force. The vehicle's bus then gives the turn rate, with the delay `late` [s].
    turns: any signal shows turns. bend: deviation of the path's curvature from the zero of a
    steering angle [1/m]. speed: without one it is an unknown (`unknown_speed`). steered: how the
    turn rate follows from a steering angle and that unknown; None: it does not.
    """

    gyro: bool = True
    turns: bool = True
    bend: float = 0.0
    late: float = 0.05
    speed: bool = True
    steered: Steered | None = None


class WeightedPrior(NamedTuple):
    """One prior of the unknowns: mean (UNKNOWNS,), covariance (UNKNOWNS, UNKNOWNS), probability."""

    mean: Array
    covariance: Array
    chance: float


class Priors(NamedTuple):
    """Deviations of the unknowns before any data, and of effects that the equations leave out.

    Data sheets are named. Sideslip, pitching and turning were set on drives of second_world, of one
    more simulator, and of the simulated seeds 970000 to 970006. None of these drives judges the
    results.
    """

    cross_axis: tuple[tuple[float, float], ...] = CROSS_AXIS
    """Sizes of the accelerometer's cross-axis terms, each with its probability."""
    gain: float = 0.013
    """Gain of one axis of the accelerometer against the others: within 3 % (MPU-6050, 6.2)."""
    zero: float = 0.3
    """Zero error of the level force [m/s^2]: limits of 50 mg (MPU-6050, 6.2), root of three."""
    gyro: float = 0.02
    """Tilt and turn of the gyroscope's axes against the accelerometer's [rad] (MPU-6050, 6.1)."""
    crown: tuple[float, float] = (0.012, 0.006)
    """Mean lean of the roads and its deviation (tangent)."""
    slope: float = SLOPE
    slow: float = 15.0
    """Speed [m/s] from which slopes become longer in proportion to the speed: curves of crests and
    sags are built for the sight distance of the design speed (assumption; AASHTO's more so).
    """
    sideslip: float = 0.0025
    """E_xy: deviation from the slip of tyres in bends."""
    pitching: float = 0.0035
    """E_zx: deviation from heave and squat in response to dv/dt."""
    turning: tuple[float, float] = (0.008, 0.004)
    """Axis of turning, x and y.

    A vehicle that rolls in bends rolls about its own axis, and the slope of bends is not that of
    the other road.
    """
    bent: float = 0.003
    """Axis of turning in bends: a gyroscope responds to force by 0.1 (deg/s)/g (MPU-6050, 6.1).

    The value is for 3 m/s^2 while the vehicle turns by 0.2 rad/s.
    """
    eliminated: tuple[float, float] = (0.012, 0.005)
    """E_xy and E_yx: deviation from effects on a speed that is not measured.

    Set on drives 01 and 02 of second_world and the simulated seeds 9000 to 9009.
    """
    uncarried: float = 0.05
    """E_xy: the same without a gyroscope (seeds 9000 to 9002 and 1300000 to 1300005)."""
    floor: float = 0.001
    """Smallest deviation of any entry."""

    @property
    def crown_variance(self) -> float:
        """Variance of the mean lean of the roads."""
        return max(self.crown[1], 1e-6) ** 2


def are_of_a_sensor(force: Matrix3, rate: Matrix3) -> bool:
    """True if the gains of both matrices (3, 3) along all directions are possible for their
    unit.
    """
    gains = np.linalg.svd(np.stack([force, rate]), compute_uv=False)
    return bool(((gains > 1.0 / MOST_GAIN) & (gains < MOST_GAIN)).all())


def own_matrices(theta: Array) -> tuple[Matrix3, Matrix3]:
    """Return matrices (3, 3) of the sensors' own errors, without the rotation phi.

    The matrix of the force is 1 + e. The matrix of the rate is 1 with the tilt of column z. theta:
    (UNKNOWNS,).
    """
    mixed, tilted = np.eye(3), np.eye(3)
    for k, place in enumerate(OFF):
        mixed[place] = theta[CROSS.start + k]
    tilted[:2, 2] = theta[EPS][:2]
    return mixed, tilted


def entry(i: int, j: int) -> Array:
    """Return the row (UNKNOWNS,) of cross-talk E_ij in the unknowns."""
    row = np.zeros(UNKNOWNS)
    axis, sign = TURN[i, j]
    row[axis] = sign
    row[CROSS.start + OFF.index((i, j))] = 1.0
    return row


def rate_entry(i: int, j: int) -> Array:
    """Return the row (UNKNOWNS,) of the rate's cross-talk in the unknowns."""
    row = np.zeros(UNKNOWNS)
    axis, sign = TURN[i, j]
    row[axis] = sign
    if j == 2:
        row[EPS.start + i] = 1.0
    if {i, j} == {0, 1}:
        row[EPS.start + 2] = sign
    return row


def zero_row(i: int) -> Array:
    """Return the row (UNKNOWNS,) of the level zero over g: the level force that remains on a level
    road.
    """
    row = entry(i, 2)
    row[ZERO.start + i] = 1.0
    return row


def level_row(i: int) -> Array:
    """Return the row of the level zero plus the mean lean of the roads that were driven."""
    row = zero_row(i)
    if i == 1:
        row[CROWN] = 1.0
    return row


def sent_variance(covariance: Array) -> Array:
    """Return the variances (8,) of the sent data's entries, in the order of SentDeviations, with
    zeros over g. covariance: (UNKNOWNS, UNKNOWNS) of the unknowns.
    """
    return np.asarray(np.maximum(((_SENT @ covariance) * _SENT).sum(axis=1), 0.0))


def sent_deviations(
    variance: Array, turned: Array = NO_TURN, zero: Array = NO_TURN
) -> SentDeviations:
    """Return the deviations from the variances (8,).

    turned: variance (3,) of a further rotation of both sensors [rad^2]. zero: variance (3,) of a
    zero that has changed [(m/s^2)^2].
    """
    variance = variance + _TURNED @ turned
    variance[4:6] = GRAVITY**2 * variance[4:6] + zero[:2]
    return SentDeviations(*np.sqrt(variance).tolist())


_SENT: Final = np.array(
    [
        *(entry(i, j) for i, j in ((0, 1), (1, 0), (2, 0), (2, 1))),
        *(level_row(i) for i in range(2)),
        *(rate_entry(i, 2) for i in range(2)),
    ]
)
"""Rows of the deviations of sent data, in the order of SentDeviations."""
_TURNED: Final = np.square(_SENT[:, PHI])
