"""The estimated mount: a rotation with its covariance."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from imucald.core.angles import DEG_PER_RAD, RAD_PER_DEG
from imucald.core.arrays import Array
from imucald.core.rotations import angles_from_rotation, quaternion_from_rotation
from imucald.mount.angle_deviations import angle_deviations
from imucald.mount.estimate import MountEstimate
from imucald.mount.mount_words import plus_minus


@dataclass(frozen=True, eq=False, repr=False)
class MountResult:
    """The orientation of the sensor in the vehicle. Axes: ISO 8855, x forward, y left, z up.

    matrix: (3, 3), R_vehicle_from_sensor: `matrix @ v_sensor` is the vector in vehicle axes.
    covariance_deg2: (3, 3) [deg^2], covariance of the error e. The error e is the rotation vector
    about the vehicle's axes from the estimate to the truth: R_true = exp(skew(e)) @ matrix.
    Elements are NaN if there is no estimate yet. The unknown lean of the road correlates the errors
    about x and z.
    """

    matrix: Array
    covariance_deg2: Array

    @classmethod
    def from_estimate(cls, estimate: MountEstimate) -> MountResult | None:
        """Return the mount of an estimate; None if there is no mount yet."""
        if estimate.R_vehicle_from_sensor is None:
            return None
        covariance = np.full((3, 3), math.nan)
        if estimate.covariance is not None:
            covariance = np.asarray(estimate.covariance) * DEG_PER_RAD**2
        return cls(np.array(estimate.R_vehicle_from_sensor), covariance)

    @classmethod
    def from_plain(cls, content: Mapping[str, Any] | None) -> MountResult | None:
        """Make a mount from the result of `plain`."""
        if content is None:
            return None
        covariance = [[math.nan if v is None else v for v in r] for r in content["covariance_deg2"]]
        return cls(np.array(content["matrix"], dtype=float), np.array(covariance, dtype=float))

    def plain(self) -> dict[str, Any]:
        """Return the mount as plain data for JSON, without loss of digits."""
        covariance = self.covariance_deg2.tolist()
        return {
            "matrix": self.matrix.tolist(),
            "covariance_deg2": [[v if math.isfinite(v) else None for v in r] for r in covariance],
        }

    @property
    def roll_deg(self) -> float:
        """Intrinsic Z-Y-X angle about x [deg]; positive: the sensor's left side is up."""
        return angles_from_rotation(self.matrix)[0] * DEG_PER_RAD

    @property
    def pitch_deg(self) -> float:
        """Intrinsic Z-Y-X angle about y [deg]; positive: the sensor's nose is down."""
        return angles_from_rotation(self.matrix)[1] * DEG_PER_RAD

    @property
    def yaw_deg(self) -> float:
        """Intrinsic Z-Y-X angle about z [deg]; positive: the sensor is turned to the left."""
        return angles_from_rotation(self.matrix)[2] * DEG_PER_RAD

    @property
    def quaternion_wxyz(self) -> tuple[float, float, float, float]:
        """Unit quaternion (w, x, y, z) of the matrix; w is not negative."""
        return quaternion_from_rotation(self.matrix)

    @property
    def std_deg(self) -> tuple[float, float, float]:
        """Standard deviations about the vehicle's x, y, z [deg]; NaN if not known yet."""
        x, y, z = np.sqrt(np.diag(self.covariance_deg2)).tolist()
        return x, y, z

    @property
    def angle_std_deg(self) -> tuple[float, float, float]:
        """Standard deviations of the angles roll, pitch and yaw [deg]; inf if not known."""
        covariance = self.covariance_deg2 * RAD_PER_DEG**2
        if not np.isfinite(covariance).all():
            return math.inf, math.inf, math.inf
        roll, pitch, yaw = angle_deviations(self.matrix, covariance.tolist())
        return roll * DEG_PER_RAD, pitch * DEG_PER_RAD, yaw * DEG_PER_RAD

    def apply(self, xyz: ArrayLike) -> Array:
        """Rotate vectors (..., 3) from sensor axes to vehicle axes. Shape and unit do not
        change."""
        turned: Array = np.asarray(xyz, dtype=float) @ self.matrix.T
        return turned

    def inverse(self) -> MountResult:
        """Return the rotation from vehicle axes to sensor axes. Its covariance is about the
        sensor's axes."""
        R = self.matrix
        return MountResult(R.T.copy(), R.T @ self.covariance_deg2 @ R)

    def __repr__(self) -> str:
        angles = zip(
            ("roll", "pitch", "yaw"),
            (self.roll_deg, self.pitch_deg, self.yaw_deg),
            self.angle_std_deg,
            strict=True,
        )
        return f"Mount({', '.join(f'{n} {v:+.2f}° {plus_minus(s)}' for n, v, s in angles)})"


@dataclass(frozen=True, eq=False)
class CorrectionResult:
    """The correction of force and rate from sensor to vehicle axes, at the end of a drive.

    matrix, offset_mps2: (3, 3) and (3,); the corrected force is matrix @ f_sensor - offset_mps2.
    gyro_matrix, gyro_offset_rad_s: the same for the angular rate. The offset is 0: a zero error of
    the gyroscope stays in the corrected rate.
    cross_talk_std_deg: standard deviations of the remaining cross-talk xy, yx, zx, zy. For
    example, xy is the part of a lateral force that the forward axis shows.
    zero_std_mps2: (2,), standard deviations of the horizontal force on level ground.
    gyro_cross_talk_std_deg: standard deviations of the cross-talk xz, yz of a rotation about z.
    A deviation that is not known is NaN.
    """

    matrix: Array
    offset_mps2: Array
    cross_talk_std_deg: Mapping[str, float]
    zero_std_mps2: Array
    gyro_matrix: Array
    gyro_offset_rad_s: Array
    gyro_cross_talk_std_deg: Mapping[str, float]

    @classmethod
    def from_summary(cls, found: Mapping[str, Any] | None) -> CorrectionResult | None:
        """Make the result from the content of the key `correction` (docs/json.md). None without a
        content."""
        if found is None:
            return None

        def known(stds: Mapping[str, float | None]) -> dict[str, float]:
            return {name: math.nan if v is None else v for name, v in stds.items()}

        return cls(
            np.array(found["matrix"], dtype=float),
            np.array(found["offset_mps2"], dtype=float),
            known(found["cross_talk_std_deg"]),
            np.array(found["zero_std_mps2"], dtype=float),
            np.array(found["gyro_matrix"], dtype=float),
            np.array(found["gyro_offset_rad_s"], dtype=float),
            known(found["gyro_cross_talk_std_deg"]),
        )
