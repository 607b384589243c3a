"""Scale of the vehicle's yaw-rate signal."""

from __future__ import annotations

from imucald.diagnosis.cause import Cause, Parameter, Values
from imucald.diagnosis.state import State

KEY = "yaw_rate.scale"


class YawRateScale(Cause):
    """measured yaw rate = (1 + scale) * true + offset."""

    name = "yaw_rate_scale"
    parameters = (Parameter(KEY, "1", 0.006, 0.08, 0.005, -0.5, 1.0),)
    signals = ("yaw_rate", "gyro_z", "accel_y", "lateral_accel")
    needs = ("yaw_rate",)
    seen_by = "drive full circles both ways with a gyroscope on the bus"
    sentence = "The vehicle's yaw rate is off by a factor."

    def inputs(self, s: State, p: Values) -> None:
        """Take the factor off."""
        if s.yaw_in is not None and p[KEY]:
            s.yaw_in = s.yaw_in / (1.0 + p[KEY])

    def gain(self, s: State, p: Values) -> None:
        """Scale the prediction from the steering."""
        if "yaw_rate" in s.signals:
            s.signals["yaw_rate"] = s.signals["yaw_rate"] * (1.0 + p[KEY])
