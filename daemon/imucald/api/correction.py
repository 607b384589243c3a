"""The correction of a drive's samples: a matrix and an offset for each sensor."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from imucald.core.arrays import Array


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
