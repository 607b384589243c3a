"""Slope of the road beyond the model's.

It is no parameter that the residual is linear in: `imucald.diagnosis.roads` measures it.
"""

from __future__ import annotations

from imucald.diagnosis.cause import Cause


class RoadGrade(Cause):
    """Slopes steeper or gentler than the model's road: gravity along the vehicle."""

    name = "road_grade"
    signals = ("accel_x", "gyro_y", "longitudinal_accel")
    needs = ("gyro",)
    seen_by = "drive over hills with a gyroscope on the bus"
    sentence = "The road is hillier than the model's."
