"""Offset of the vehicle's yaw-rate signal."""

from __future__ import annotations

from imucald.diagnosis.cause import Cause, Parameter, Values
from imucald.diagnosis.state import State

KEY = "yaw_rate.offset"
DEG = 0.017453292519943295


class YawRateOffset(Cause):
    """measured yaw rate = (1 + scale) * true + offset."""

    name = "yaw_rate_offset"
    parameters = (Parameter(KEY, "rad/s", 0.05 * DEG, 0.7 * DEG, 0.05 * DEG),)
    signals = ("yaw_rate", "gyro_z", "accel_y", "lateral_accel")
    needs = ("yaw_rate",)
    seen_by = "stand still for a minute"
    sentence = "The vehicle's yaw rate shows a rate at rest."

    def inputs(self, s: State, p: Values) -> None:
        """Take the offset off."""
        if s.yaw_in is not None and p[KEY]:
            s.yaw_in = s.yaw_in - p[KEY]

    def offset(self, s: State, p: Values) -> None:
        """Add it to the prediction from the steering."""
        if "yaw_rate" in s.signals:
            s.signals["yaw_rate"] = s.signals["yaw_rate"] + p[KEY]
