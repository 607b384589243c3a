"""What is applied to the samples of a drive: a matrix and an offset for each sensor."""

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

    matrix, offset_mps2: (3, 3), (3,): matrix @ f_sensor - offset_mps2 is sent. gyro_matrix,
    gyro_offset_rad_s: the same for the rate. cross_talk_std_deg: xy, yx, zx, zy, standard
    deviations of what is left of a force in another axis: of xy, the part of a lateral force that
    the forward axis shows. zero_std_mps2: (2,), of the level force on level ground.
    gyro_cross_talk_std_deg: xz, yz, of turning about z. NaN where a deviation is not known.
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
        """Make one from `correction` of docs/json.md; None where there is none."""
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
