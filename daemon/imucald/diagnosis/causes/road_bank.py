"""Cross fall of the road beyond the model's.

It is no parameter that the residual is linear in: `imucald.diagnosis.roads` measures it.
"""

from __future__ import annotations

from imucald.diagnosis.cause import Cause


class RoadBank(Cause):
    """Cross fall that wanders more than the model's: gravity across the vehicle."""

    name = "road_bank"
    signals = ("accel_y", "gyro_x", "lateral_accel")
    needs = ("gyro",)
    seen_by = "drive roads of changing cross fall with a gyroscope on the bus"
    sentence = "The road's cross fall wanders more than the model's."
