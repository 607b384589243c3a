"""Speed scale: tyres of another radius than the control unit believes."""

from __future__ import annotations

from imucald.diagnosis.cause import Cause, Parameter, Values
from imucald.diagnosis.state import State

KEY = "speed.scale"


class WheelSpeedScale(Cause):
    """measured speed = (1 + scale) * true."""

    name = "wheel_speed_scale"
    parameters = (Parameter(KEY, "1", 0.005, 0.05, 0.005, -0.5, 1.0),)
    signals = ("accel_x", "accel_y", "yaw_rate", "lateral_accel", "longitudinal_accel")
    seen_by = "brake and corner hard with a gyroscope on the bus"
    sentence = "The speed is off by a factor (tyre radius)."

    def inputs(self, s: State, p: Values) -> None:
        """Take the factor off."""
        if p[KEY]:
            s.speed = s.speed / (1.0 + p[KEY])
