"""The unknowns of the joint estimate, with unit, prior and source.

All are about the working axes, in which force and rate are nearly along the vehicle's:

    force = (1 + E) true force + g b      E = [phi x] + e
    rate  = (1 + C) true rate             C = [phi x] + [(0, 0, eps_z) x] + tilt of column z
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from imucald.core.arrays import Array
from imucald.core.rotations import Matrix3
from imucald.core.samples import GRAVITY
from imucald.mount.estimate import SentDeviations
from imucald.mount.priors import CROSS_AXIS

OFF: Final = ((0, 1), (1, 0), (0, 2), (2, 0), (1, 2), (2, 1))
"""Places of the cross-axis terms e in a matrix."""
TURN: Final = {
    (0, 1): (2, -1.0), (1, 0): (2, 1.0), (0, 2): (1, 1.0), (2, 0): (1, -1.0), (1, 2): (0, -1.0),
    (2, 1): (0, 1.0),
}  # fmt: skip
"""Axis and sign with which a turn by phi stands at each place of [phi x]."""
PHI, CROSS, ZERO, EPS, CROWN = slice(0, 3), slice(3, 9), slice(9, 11), slice(11, 14), 14
UNKNOWNS = 15
MOST_GAIN = 1.45
"""Of a sensor's matrix along any direction: four deviations of cross-axis terms of 8 %, the largest
size that is asked, in two places."""
SLOPE, SLOPE_M = 0.02, 400.0
"""Slope of a road (tangent), and metres after which it is another one: twice its memory."""
FREE = 10.0
"""Prior deviation of a rotation of which nothing is known [rad]."""


class OtherSignals(NamedTuple):
    """What there is next to the accelerometer and the speed.

    gyro: the sensor has one; else the vertical is not carried, slopes are noise of the level force,
    and the vehicle's bus says how it turns, by so much late [s]. turns: any signal shows turns.
    bend: deviation of the path's curvature that the zero of a steering angle leaves [1/m].
    """

    gyro: bool = True
    turns: bool = True
    bend: float = 0.0
    late: float = 0.05


class WeightedPrior(NamedTuple):
    """One prior of the unknowns: mean (UNKNOWNS,), covariance (UNKNOWNS, UNKNOWNS), probability."""

    mean: Array
    covariance: Array
    chance: float


class Priors(NamedTuple):
    """Deviations of the unknowns before any data, and of what the equations leave out.

    Data sheets are named. Sideslip, pitching and turning were set on drives: second_world, one
    more simulator, and simulated seeds 970000 to 970006, none of which judges them.
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
    """Slopes of roads for speeds far beyond [m/s] are longer in proportion to the speed: curves of
    crests and sags are built for the sight that a speed needs (assumption; AASHTO's more so)."""
    sideslip: float = 0.0025
    """E_xy: slip of the tyres in bends."""
    pitching: float = 0.0035
    """E_zx: heave and squat that answer to dv/dt."""
    turning: tuple[float, float] = (0.008, 0.004)
    """Axis of turning, x and y: a vehicle that rolls in bends rolls about an axis of its own, and
    the slope of the bends is not that of the road."""
    bent: float = 0.003
    """Axis of turning in bends: a gyroscope answers to force by 0.1 (deg/s)/g (MPU-6050, 6.1), here
    to 3 m/s^2 while the vehicle turns by 0.2 rad/s."""
    floor: float = 0.001
    """Any entry."""

    @property
    def crown_variance(self) -> float:
        """Of the mean lean of the roads."""
        return max(self.crown[1], 1e-6) ** 2


def are_of_a_sensor(force: Matrix3, rate: Matrix3) -> bool:
    """Whether the gains of both matrices (3, 3) along all directions are those of their unit."""
    gains = np.linalg.svd(np.stack([force, rate]), compute_uv=False)
    return bool(((gains > 1.0 / MOST_GAIN) & (gains < MOST_GAIN)).all())


def own_matrices(theta: Array) -> tuple[Matrix3, Matrix3]:
    """Matrices (3, 3) of the sensors' own errors, without the turn phi: 1 + e of the force, and 1
    with the tilt of column z of the rate. theta: (UNKNOWNS,)."""
    mixed, tilted = np.eye(3), np.eye(3)
    for k, place in enumerate(OFF):
        mixed[place] = theta[CROSS.start + k]
    tilted[:2, 2] = theta[EPS][:2]
    return mixed, tilted


def entry(i: int, j: int) -> Array:
    """Row (UNKNOWNS,) of cross-talk E_ij in the unknowns."""
    row = np.zeros(UNKNOWNS)
    axis, sign = TURN[i, j]
    row[axis] = sign
    row[CROSS.start + OFF.index((i, j))] = 1.0
    return row


def rate_entry(i: int, j: int) -> Array:
    """Row (UNKNOWNS,) of the rate's cross-talk in the unknowns."""
    row = np.zeros(UNKNOWNS)
    axis, sign = TURN[i, j]
    row[axis] = sign
    if j == 2:
        row[EPS.start + i] = 1.0
    if {i, j} == {0, 1}:
        row[EPS.start + 2] = sign
    return row


def zero_row(i: int) -> Array:
    """Row (UNKNOWNS,) of the level zero over g: what a level force keeps on a level road."""
    row = entry(i, 2)
    row[ZERO.start + i] = 1.0
    return row


def level_row(i: int) -> Array:
    """Row of the level zero, with the mean lean of the roads that were driven."""
    row = zero_row(i)
    if i == 1:
        row[CROWN] = 1.0
    return row


def sent_deviations(covariance: Array, wide: float = 0.0) -> SentDeviations:
    """Of the unknowns' errors; wide: of a turn of both sensors besides [rad]."""
    variance = ((_SENT @ covariance) * _SENT).sum(axis=1)
    std = np.sqrt(np.maximum(variance, 0.0) + wide**2)
    std[4:6] *= GRAVITY
    return SentDeviations(*std.tolist())


_SENT: Final = np.array(
    [
        *(entry(i, j) for i, j in ((0, 1), (1, 0), (2, 0), (2, 1))),
        *(level_row(i) for i in range(2)),
        *(rate_entry(i, 2) for i in range(2)),
    ]
)
"""Rows of what a consumer gets, in the order of SentDeviations."""
