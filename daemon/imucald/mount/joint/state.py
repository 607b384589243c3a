"""The unknowns of the joint estimate: units, priors and sources of the priors.

All unknowns are errors of the working axes. Force and rate in the working axes are nearly along the
vehicle's axes:

    force = (1 + E) true force + g b      E = [phi x] + e
    rate  = (1 + C) true rate             C = [phi x] + [(0, 0, eps_z) x] + tilt of column z
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from imucald.core.arrays import Array, inverse, solved
from imucald.core.rotations import Matrix3
from imucald.core.samples import GRAVITY
from imucald.drive.roads import SLOPE
from imucald.drive.unknown_speed import Steered
from imucald.mount.estimate import SentDeviations

OFF: Final = ((0, 1), (1, 0), (0, 2), (2, 0), (1, 2), (2, 1))
"""Positions of the cross-axis terms e in the matrix E."""
TURN: Final = {
    (0, 1): (2, -1.0), (1, 0): (2, 1.0), (0, 2): (1, 1.0), (2, 0): (1, -1.0), (1, 2): (0, -1.0),
    (2, 1): (0, 1.0),
}  # fmt: skip
"""Axis and sign of the rotation phi at each position of the matrix [phi x]."""
PHI, CROSS, ZERO, EPS, CROWN = slice(0, 3), slice(3, 9), slice(9, 11), slice(11, 14), 14
ZERO_VECTOR: Final = np.zeros(3)
UNKNOWNS = 15
MOST_GAIN = 1.45
"""Largest gain of a sensor's matrix in any direction.

The value is 1 plus four standard deviations of the sum of two cross-axis terms of 8 %. The size of
8 % is the largest size of cross-axis terms that is tested.
"""
IN_BENDS: Final = (0.01, 0.01, 0.02)
"""Prior standard deviations of the responses of the force to (v r)^2 [s^2/m], by axis.

Tyres slip in bends: 700 kg on a rear axle with a cornering stiffness of 100 kN/rad give 0.007 along
x. Bodies lean in bends by 4 to 6 deg/g, which is 0.007 to 0.011 along z (assumptions).
"""
LAG: Final = (0.05, 0.15, 0.05)
"""Prior standard deviations of the responses of the force to d(v r)/dt [s], by axis: the lag of the
lateral velocity and of the body in bends (assumption).
"""
FREE = 10.0
"""Prior standard deviation of an unknown rotation [rad]."""


class OtherSignals(NamedTuple):
    """Available signals in addition to the accelerometer.

    gyro: the sensor has a gyroscope. Without a gyroscope, the vertical is not integrated, and
    slopes are noise of the horizontal force. The turn rate then comes from the vehicle's bus. late:
    delay of this turn rate [s]. turns: any signal shows turns. bend: standard deviation of the
    path's curvature from the zero error of a steering angle [1/m]. speed: there is a speed signal.
    Without a speed signal, the speed is an unknown (`unknown_speed`). steered: relation between a
    steering angle, the unknown speed and the turn rate; None: the turn rate does not come from a
    steering angle.
    """

    gyro: bool = True
    turns: bool = True
    bend: float = 0.0
    late: float = 0.05
    speed: bool = True
    steered: Steered | None = None


class WeightedPrior(NamedTuple):
    """One prior of the unknowns: mean (UNKNOWNS,), covariance (UNKNOWNS, UNKNOWNS), and probability
    of the prior.
    """

    mean: Array
    covariance: Array
    chance: float


class Priors(NamedTuple):
    """Standard deviations of the unknowns before any data, and of effects without a term in the
    equations.

    Sources are data sheets or simulated drives. Data sheets are named at each value (MPU-6050:
    PS-MPU-6000A-00 rev. 3.4). A "typical" value of a maker is used as one standard deviation.
    Sideslip, pitching and turning were chosen on drives of second_world, on drives of another
    simulator, and on the simulated drives with the seeds 970000 to 970006. None of these drives is
    used to judge results.
    """

    cross_axis: tuple[tuple[float, float], ...] = (
        (0.001, 0.12), (0.005, 0.18), (0.01, 0.2), (0.02, 0.22), (0.04, 0.18), (0.08, 0.1),
    )  # fmt: skip
    """Sizes of the accelerometer's cross-axis terms (ratio, rms), each with its probability.

    Only the order of magnitude is known, so sizes from 0.5 % to 4 % are about equally probable.
    Data sheets of bare parts state 2 % (MPU-6050, 6.2; ICM-20948, DS-000189, 3.2) and 3 % (ADXL350,
    table 1), and do not say whether this is a typical or a largest value. One unit in eight was
    calibrated by its maker to 0.1 %. Soldering, gluing and bending enlarge the error of the other
    units several times, so 8 % is included.
    """
    gain: float = 0.013
    """Gain of one axis of the accelerometer relative to the other axes: within 3 % (MPU-6050, 6.2).
    """
    zero: float = 0.3
    """Zero error of the horizontal force [m/s^2]: the limit of 50 mg (MPU-6050, 6.2) divided by the
    root of three.
    """
    gyro: float = 0.02
    """Rotation of the gyroscope's axes relative to the accelerometer's axes [rad] (MPU-6050, 6.1).
    """
    crown: tuple[float, float] = (0.012, 0.006)
    """Mean lean of the roads, and standard deviation of this mean (tangent)."""
    slope: float = SLOPE
    sideslip: float = 0.0025
    """Deviation of E_xy from the slip of tyres in bends."""
    pitching: float = 0.0035
    """Deviation of E_zx from heave and squat in response to dv/dt."""
    turning: tuple[float, float] = (0.008, 0.004)
    """Deviations of the axis of turning in x and y.

    The body of a vehicle rolls in bends about its own axis. The slope of roads in bends differs
    from the slope of straight roads.
    """
    bent: float = 0.003
    """Deviation of the axis of turning in bends from the response of a gyroscope to force: 0.1
    (deg/s)/g (MPU-6050, 6.1).

    The value is for a force of 3 m/s^2 and a turn rate of 0.2 rad/s.
    """
    eliminated: tuple[float, float] = (0.012, 0.005)
    """Deviations of E_xy and E_yx from errors of an estimated speed, in drives without a speed
    signal.

    The values were chosen on the drives 01 and 02 of second_world and the simulated drives with the
    seeds 9000 to 9009.
    """
    uncarried: float = 0.05
    """Deviation of E_xy in drives without a speed signal and without a gyroscope (simulated drives
    with the seeds 9000 to 9002 and 1300000 to 1300005).
    """
    floor: float = 0.001
    """Smallest deviation of any entry of the error matrix."""

    @property
    def crown_variance(self) -> float:
        """Variance of the mean lean of the roads."""
        return max(self.crown[1], 1e-6) ** 2


def are_of_a_sensor(force: Matrix3, rate: Matrix3) -> bool:
    """True if the gains of both matrices (3, 3) in all directions are possible for a sensor."""
    gains = np.linalg.svd(np.stack([force, rate]), compute_uv=False)
    return bool(((gains > 1.0 / MOST_GAIN) & (gains < MOST_GAIN)).all())


def own_matrices(theta: Array) -> tuple[Matrix3, Matrix3]:
    """Return the matrices (3, 3) of the sensors' own errors for force and rate, without the
    rotation phi.

    The matrix of the force is 1 + e. The matrix of the rate is 1 plus the tilt of column z. theta:
    (UNKNOWNS,) unknowns.
    """
    mixed, tilted = np.eye(3), np.eye(3)
    for k, place in enumerate(OFF):
        mixed[place] = theta[CROSS.start + k]
    tilted[:2, 2] = theta[EPS][:2]
    return mixed, tilted


def own_terms(housing: Matrix3, force: Matrix3, rate: Matrix3, zero: Array) -> Array:
    """Return the unknowns (UNKNOWNS,) that belong to the sensor itself and that a correction takes
    into account. The other unknowns are zero.

    housing: (3, 3) R_vehicle_from_sensor of the housing. force, rate: (3, 3) matrices from sensor
    axes to vehicle axes. zero: (3,) zero error of the force in vehicle axes [m/s^2].
    """
    mixed, tilted = housing @ inverse(force), housing @ inverse(rate)
    terms = np.zeros(UNKNOWNS)
    terms[CROSS] = [mixed[place] for place in OFF]
    terms[ZERO] = (mixed @ zero)[:2] / GRAVITY
    terms[EPS][:2] = tilted[:2, 2]
    return terms


def without_gains(
    housing: Matrix3, force: Matrix3, rate: Matrix3, zero: Array
) -> tuple[Matrix3, Matrix3, Array]:
    """Return force, rate and zero of a correction whose sensor has no other terms than those of
    `own_terms`. The arguments are the same as in `own_terms`.
    """
    mixed, tilted = own_matrices(own_terms(housing, force, rate, zero))
    plain = solved(mixed, housing)
    return plain, solved(tilted, housing), plain @ solved(force, zero)


def entry(i: int, j: int) -> Array:
    """Return the derivatives (UNKNOWNS,) of the force's cross-talk E_ij with respect to the
    unknowns.
    """
    row = np.zeros(UNKNOWNS)
    axis, sign = TURN[i, j]
    row[axis] = sign
    row[CROSS.start + OFF.index((i, j))] = 1.0
    return row


def rate_entry(i: int, j: int) -> Array:
    """Return the derivatives (UNKNOWNS,) of the rate's cross-talk C_ij with respect to the
    unknowns.
    """
    row = np.zeros(UNKNOWNS)
    axis, sign = TURN[i, j]
    row[axis] = sign
    if j == 2:
        row[EPS.start + i] = 1.0
    if {i, j} == {0, 1}:
        row[EPS.start + 2] = sign
    return row


def zero_row(i: int) -> Array:
    """Return the derivatives (UNKNOWNS,) of the level zero along axis i with respect to the
    unknowns. The level zero is the horizontal force that remains on a level road, divided by g.
    """
    row = entry(i, 2)
    row[ZERO.start + i] = 1.0
    return row


def level_row(i: int) -> Array:
    """Return the derivatives (UNKNOWNS,) of the mean horizontal force along axis i, divided by g.
    On real roads, this force is the sum of the level zero and the mean lean of the roads.
    """
    row = zero_row(i)
    if i == 1:
        row[CROWN] = 1.0
    return row


def sent_variance(covariance: Array) -> Array:
    """Return the variances (8,) of the entries of SentDeviations, in the same order. The zero
    errors are divided by g. covariance: (UNKNOWNS, UNKNOWNS) covariance of the unknowns.
    """
    return np.asarray(np.maximum(((_SENT @ covariance) * _SENT).sum(axis=1), 0.0))


def sent_deviations(
    variance: Array, turned: Array = ZERO_VECTOR, zero: Array = ZERO_VECTOR
) -> SentDeviations:
    """Return the deviations of the sent data from their variances (8,).

    turned: (3,) variance of an additional rotation of both sensors [rad^2]. zero: (3,) variance of
    an additional change of the zero error [(m/s^2)^2].
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
"""Derivatives of the entries of SentDeviations with respect to the unknowns, in the same order."""
_TURNED: Final = np.square(_SENT[:, PHI])
