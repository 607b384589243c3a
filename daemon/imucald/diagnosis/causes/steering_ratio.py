"""Steering ratio: wheel angle over road-wheel angle."""

from __future__ import annotations

from imucald.diagnosis.cause import Cause, Parameter


class SteeringRatio(Cause):
    """road-wheel angle = steering-wheel angle / ratio; used where the vehicle is steered."""

    name = "steering_ratio"
    parameters = (Parameter("chassis.steering_ratio", "1", 0.23, 3.0, 0.3, 3.0, 40.0),)
    signals = ("yaw_rate",)
    needs = ("steering", "yaw_rate")
    seen_by = "turn tightly at low speed, where understeer does not count"
    sentence = "The steering ratio is not the model's."
