"""Understeer gradient: steering that grows with lateral acceleration."""

from __future__ import annotations

from imucald.diagnosis.cause import Cause, Parameter


class Understeer(Cause):
    """yaw rate = v delta / (L + K v^2); used where the vehicle is steered."""

    name = "understeer"
    parameters = (
        Parameter(
            "chassis.understeer_gradient", "rad/(m/s^2)", 0.0003, 0.003, 0.0003, -0.002, share=0.12
        ),
    )
    signals = ("yaw_rate",)
    needs = ("steering", "yaw_rate")
    seen_by = "corner at high speed as well as tightly at low speed"
    sentence = "The understeer gradient (tyre stiffness) is not the model's."
