"""Data of a sensor itself, which stay valid after a drive, after a restart and in a new mount.

The terms of the sensor are stored in the sensor's own axes. A rotation of the housing does not
change the terms in these axes. Some terms cannot be estimated from a drive, for example the gains.
These terms keep their prior deviation. If the housing is rotated, these terms become cross-axis
terms of the new axes.

There are several hypotheses about the time since the previous drive. One hypothesis is that nothing
has changed. Two hypotheses are that the sensor was moved by a small angle or by any angle. The last
hypothesis is that another sensor is mounted. Each hypothesis is a prior, and its probability is
computed from the data. A hypothesis that contradicts the data gets little weight.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np

from imucald.core.arrays import Array, solved
from imucald.core.errors import EstimateError
from imucald.core.rotations import (
    Matrix3,
    orthonormalised,
    rotation_from_vector,
    vector_from_rotation,
)
from imucald.core.samples import GRAVITY
from imucald.mount.estimate import BETWEEN_DRIVES_STD, Correction, SentDeviations
from imucald.mount.joint.state import (
    CROSS,
    CROWN,
    EPS,
    FREE,
    OFF,
    PHI,
    UNKNOWNS,
    ZERO,
    Priors,
    WeightedPrior,
    are_of_a_sensor,
    own_matrices,
    sent_deviations,
    sent_variance,
)

TURN, ACCEL, BIAS, GYRO = slice(0, 3), slice(3, 12), slice(12, 15), slice(15, 24)
TERMS = 24
"""Number of terms: rotation of the housing in vehicle axes (3), the accelerometer's matrix (9), the
accelerometer's zero error divided by g (3), and the gyroscope's matrix (9).
"""
PROBABLY_OTHER = 0.005
"""Probability that another sensor is mounted, or that the sensor itself has changed, since the
previous drive (assumption).
"""
BIAS_DRIFT_STD = 0.04
"""Change of the accelerometer's zero error while the sensor warms up [m/s^2], 4 mg.

The value is an assumption: 0.1 mg/K times 40 K from a cold start. The data sheet of an older part
states 35 mg over 0 to 70 degC (MPU-6050).
"""
PROBABLY_MOVED: Final = ((0.1, 0.005), (FREE, 0.005))
"""Standard deviation of a rotation between two drives [rad], and probability of this rotation. A
rotation happens if somebody touches or remounts the sensor (assumption: one start in a hundred).
"""
AS_BEFORE = 0
"""Index of the hypothesis that nothing has changed."""
CHANCE_AS_BEFORE = (1.0 - PROBABLY_OTHER) * (1.0 - sum(chance for _, chance in PROBABLY_MOVED))
"""Probability at the start of a drive that nothing has changed."""
LARGEST = 1.0
"""Limit for the size of every term, and limit for the standard deviation of every term. The terms
of a real sensor are smaller than this limit.
"""
APART = 0.2
"""Largest difference between an element of the stored rotation and the same element of the
housing's rotation.

Within one mount, cross-axis terms cause a difference of some hundredths. If the difference is
larger than the limit, the rotations belong to different mounts.
"""
_UPPER = np.triu_indices(TERMS)
_XY, _YX, _XZ, _YZ = (GYRO.start + k for k in (1, 3, 2, 5))


class KnownSensor(NamedTuple):
    """Stored data of a sensor.

    rotation: (3, 3) R_vehicle_from_sensor of the housing when the data were stored. mean: (TERMS,)
    mean of the terms. covariance: (TERMS, TERMS) covariance of the terms. The first three terms are
    a small rotation of the housing relative to `rotation`, in vehicle axes. The other terms are in
    sensor axes.
    """

    rotation: Matrix3
    mean: Array
    covariance: Array

    @classmethod
    def found(
        cls, rotation: Matrix3, mean: Array, covariance: Array, priors: Priors
    ) -> KnownSensor:
        """Return the sensor data that follow from an estimate of the unknowns.

        rotation: (3, 3) R_vehicle_from_sensor of the housing. mean, covariance: (UNKNOWNS,) and
        (UNKNOWNS, UNKNOWNS) of the unknowns, relative to the present axes of the housing.
        """
        place = np.zeros((TERMS, UNKNOWNS))
        place[TURN, PHI] = np.eye(3)
        for k, (i, j) in enumerate(OFF):
            place[ACCEL.start + 3 * i + j, CROSS.start + k] = 1.0
        for i in range(2):
            place[BIAS.start + i, ZERO.start + i] = 1.0
        place[_XZ, EPS.start] = place[_YZ, EPS.start + 1] = place[_YX, EPS.start + 2] = 1.0
        place[_XY, EPS.start + 2] = -1.0
        unseen = np.zeros(TERMS)
        unseen[ACCEL][::4] = priors.gain**2
        unseen[BIAS.stop - 1] = (priors.zero / GRAVITY) ** 2
        unseen[GYRO] = priors.gyro**2
        unseen[[_XZ, _YZ]] = 0.0
        turned = _turned(rotation.T)
        whole = place @ covariance @ place.T + np.diag(unseen)
        return cls(rotation, turned @ place @ mean, turned @ whole @ turned.T)

    def turned(self, by: Array, variance: Array) -> KnownSensor:
        """Return the data after a rotation of the housing. by: (3,) rotation vector in vehicle axes
        [rad]. variance: (3,) variance of this rotation [rad^2].
        """
        covariance = self.covariance.copy()
        covariance[TURN, TURN] += np.diag(variance)
        return self._replace(
            rotation=rotation_from_vector(by) @ self.rotation, covariance=covariance
        )

    def away(self) -> KnownSensor:
        """Return the same data with larger deviations, because the sensor may be cold after parking
        and the load of the vehicle may have changed.
        """
        wider = np.zeros(TERMS)
        wider[TURN] = np.square(BETWEEN_DRIVES_STD)
        wider[BIAS] = (BIAS_DRIFT_STD / GRAVITY) ** 2
        return self._replace(covariance=self.covariance + np.diag(wider))

    def hypotheses(self, axes: Matrix3, priors: Priors, is_moved: bool) -> list[WeightedPrior]:
        """Return hypotheses about the changes since the data were stored, as priors relative to
        working axes (3, 3).

        is_moved: the sensor was certainly moved. The result does not contain the hypothesis of
        another sensor. The probabilities in the result therefore add up to 1 minus
        `PROBABLY_OTHER`.
        """
        mean, covariance = self._about(axes, priors)
        sizes = ((FREE, 1.0),) if is_moved else PROBABLY_MOVED
        made: list[WeightedPrior] = []
        for size, chance in sizes:
            wide = covariance.copy()
            wide[PHI], wide[:, PHI] = 0.0, 0.0
            wide[PHI, PHI] = covariance[PHI, PHI] + size**2 * np.eye(3)
            made.append(WeightedPrior(mean, wide, (1.0 - PROBABLY_OTHER) * chance))
        if not is_moved:
            made.insert(AS_BEFORE, WeightedPrior(mean, covariance, CHANCE_AS_BEFORE))
        return made

    def _about(self, axes: Matrix3, priors: Priors) -> tuple[Array, Array]:
        """Return mean and covariance of the unknowns relative to working axes (3, 3)."""
        take = np.zeros((UNKNOWNS, TERMS))
        turned = _turned(axes)
        take[PHI, TURN] = np.eye(3)
        for k, (i, j) in enumerate(OFF):
            take[CROSS.start + k] = turned[ACCEL.start + 3 * i + j]
        take[ZERO] = turned[BIAS][:2]
        take[EPS.start], take[EPS.start + 1] = turned[_XZ], turned[_YZ]
        take[EPS.start + 2] = 0.5 * (turned[_YX] - turned[_XY])
        mean, covariance = take @ self.mean, take @ self.covariance @ take.T
        covariance[CROWN, CROWN] = priors.crown_variance
        mean[PHI] = vector_from_rotation(axes @ self.rotation.T)
        return mean, covariance

    def correction(self, R_vehicle_from_sensor: Matrix3) -> Correction:
        """Return the correction of the samples in the earlier mount. R_vehicle_from_sensor: (3, 3)
        rotation of the housing.

        Raises EstimateError if this rotation and the stored data belong to different mounts, or if
        no sensor has such terms.
        """
        R = self.rotation
        if np.abs(R_vehicle_from_sensor - R).max() > APART:
            raise EstimateError("the saved data of the sensor belong to another mount")
        mean, _ = self._about(R, Priors())
        mixed, tilted = own_matrices(mean)
        if not are_of_a_sensor(mixed, tilted):
            raise EstimateError("the saved data of the sensor are impossible for a sensor")
        zero = np.concatenate([mean[ZERO] * GRAVITY, [0.0]])
        force = solved(mixed, R)
        rate = solved(tilted, R)
        zero = np.linalg.solve(mixed, zero)
        return Correction.with_matrices(R_vehicle_from_sensor, force, rate, zero)

    def sent(self) -> SentDeviations:
        """Return the deviations of samples after `correction`, in the earlier mount."""
        return sent_deviations(sent_variance(self._about(self.rotation, Priors())[1]))

    def plain(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "rotation": self.rotation.ravel().tolist(),
            "mean": [float(f"{v:.9g}") for v in self.mean.tolist()],
            "covariance": [float(f"{v:.9g}") for v in self.covariance[_UPPER].tolist()],
        }


def known_from(content: object) -> KnownSensor:
    """Return the sensor data from a result of `plain`. Raises EstimateError if the content is not
    valid.
    """
    try:
        if not isinstance(content, Mapping):
            raise TypeError("not written by imucald")
        rotation = _numbers(content["rotation"], 9).reshape(3, 3)
        mean = _numbers(content["mean"], TERMS)
        covariance = np.zeros((TERMS, TERMS))
        covariance[_UPPER] = _numbers(content["covariance"], len(_UPPER[0]))
        covariance += np.triu(covariance, 1).T
        if np.abs(orthonormalised(rotation) - rotation).max() > 1e-6:
            raise ValueError("no rotation")
        values, axes = np.linalg.eigh(covariance)
        if np.abs(mean).max() > LARGEST or values[-1] > LARGEST or values[0] < -1e-6 * values[-1]:
            raise ValueError("out of range")
        if np.diag(covariance).min() <= 0.0:
            raise ValueError("a standard deviation is not positive")
    except (KeyError, TypeError, ValueError, AttributeError, np.linalg.LinAlgError) as error:
        raise EstimateError(f"the saved data of the sensor cannot be used ({error})") from None
    return KnownSensor(rotation, mean, np.asarray((axes * np.maximum(values, 0.0)) @ axes.T))


def _numbers(values: object, n: int) -> Array:
    if not isinstance(values, list) or len(values) != n:
        raise ValueError(f"{n} numbers are needed")
    if not all(type(v) in (int, float) and math.isfinite(v) and abs(v) < 1e6 for v in values):
        raise ValueError("a number is missing")
    return np.array(values, dtype=float)


def _turned(R: Matrix3) -> Array:
    """Return the matrix (TERMS, TERMS) that transforms the terms into axes rotated by R. The terms
    of the housing's rotation stay unchanged.
    """
    made = np.eye(TERMS)
    made[ACCEL, ACCEL] = made[GYRO, GYRO] = np.kron(R, R)
    made[BIAS, BIAS] = R
    return made
