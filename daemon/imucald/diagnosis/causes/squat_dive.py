"""Squat and dive: the body pitches with longitudinal force."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imucald.diagnosis.cause import Cause, Parameter, Values, Variant
from imucald.diagnosis.state import State

SQUAT, DIVE = "suspension.squat_gradient", "suspension.dive_gradient"


class SquatDive(Cause):
    """pitch = -gradient * longitudinal specific force, through a second-order system."""

    name = "squat_dive"
    parameters = tuple(
        Parameter(key, "rad/(m/s^2)", 0.0005, 0.006, 0.0005) for key in (SQUAT, DIVE)
    )
    signals = ("accel_x", "accel_z", "gyro_y", "longitudinal_accel")
    seen_by = "accelerate and brake hard with a gyroscope on the bus"
    sentence = "The body squats and dives otherwise than the model's."

    def variants(self) -> Sequence[Variant]:
        """Both, or one of them."""
        both = Variant(self.name, "", (SQUAT, DIVE))
        return (both, Variant(self.name, "squat", (SQUAT,)), Variant(self.name, "dive", (DIVE,)))

    def body(self, s: State, p: Values) -> None:
        """Pitch the body."""
        suspension = s.model.suspension
        if not suspension.squat_dive:
            return
        force = s.force[0]
        wanted = p[SQUAT] * np.maximum(force, 0.0) + p[DIVE] * np.minimum(force, 0.0)
        frequency = suspension.pitch_frequency_hz * (1.0 + p.get("_pitch_frequency", 0.0))
        response = s.spectrum.second_order(frequency, suspension.pitch_damping)
        s.lean_pitch = s.lean_pitch - s.spectrum.apply(wanted, response)
