"""Body roll: the body leans out of the turn."""

from __future__ import annotations

from imucald.diagnosis.cause import Cause, Parameter, Values
from imucald.diagnosis.state import State

ROLL = "suspension.roll_gradient"


class BodyRoll(Cause):
    """roll = gradient * lateral specific force, through a second-order system."""

    name = "body_roll"
    parameters = (Parameter(ROLL, "rad/(m/s^2)", 0.001, 0.01, 0.001),)
    signals = ("accel_y", "gyro_x", "lateral_accel")
    needs = ("turning",)
    seen_by = "corner hard both ways with a gyroscope on the bus"
    sentence = "The body rolls otherwise than the model's."

    def body(self, s: State, p: Values) -> None:
        """Roll the body."""
        suspension = s.model.suspension
        if not suspension.body_roll:
            return
        frequency = suspension.roll_frequency_hz * (1.0 + p.get("_roll_frequency", 0.0))
        response = s.spectrum.second_order(frequency, suspension.roll_damping)
        s.lean_roll = s.lean_roll + s.spectrum.apply(p[ROLL] * s.force[1], response)
