"""Steering angle that is not zero straight ahead."""

from __future__ import annotations

from imucald.diagnosis.cause import Cause, Parameter, Values
from imucald.diagnosis.state import State

KEY = "steering.offset"
DEG = 0.017453292519943295


class SteeringOffset(Cause):
    """measured steering-wheel angle = true + offset."""

    name = "steering_offset"
    parameters = (Parameter(KEY, "rad", 0.5 * DEG, 6.0 * DEG, 0.5 * DEG),)
    signals = ("yaw_rate",)
    needs = ("steering", "yaw_rate")
    seen_by = "drive straight on a level road at two speeds, in both directions"
    sentence = "The steering angle has an offset."

    def inputs(self, s: State, p: Values) -> None:
        """Take the offset off."""
        if s.steer is not None and p[KEY]:
            s.steer = s.steer - p[KEY]
