"""The sensor sits elsewhere than the model file says."""

from __future__ import annotations

import numpy as np

from imucald.diagnosis.cause import Cause, Parameter, Values
from imucald.diagnosis.grid import Array
from imucald.diagnosis.state import State

KEYS = tuple(f"mount.lever_arm_m.{i}" for i in range(3))
SHARES = (0.12, 0.12, 0.3)
FLOORS = (0.6, 0.6, 1.5)
"""The height acts through roll and pitch accelerations, which springs and gyroscope blur."""


class LeverArm(Cause):
    """force at the sensor = force at the reference + dw/dt x l + w x (w x l)."""

    name = "lever_arm"
    parameters = tuple(
        Parameter(key, "m", 0.1, 1.5, 0.2, share=share, floor=floor)
        for key, share, floor in zip(KEYS, SHARES, FLOORS, strict=True)
    )
    signals = ("accel_x", "accel_y", "accel_z")
    needs = ("turning",)
    seen_by = "turn tightly at walking speed and change lanes quickly"
    sentence = "The sensor's place (lever arm) is not the model's."

    def place(self, s: State, p: Values) -> None:
        """Carry the force from the body's reference to the sensor."""
        arm = np.array([p[key] for key in KEYS])
        if not arm.any() or not s.model.mount.lever_arm:
            return
        w = s.rate if s.gyro_in is None else s.rate_in
        s.force = s.force + _crossed(s.spectrum.derivative(w), arm) + _crossed_twice(w, arm)


def _crossed(a: Array, arm: Array) -> Array:
    return np.array(
        [
            a[1] * arm[2] - a[2] * arm[1],
            a[2] * arm[0] - a[0] * arm[2],
            a[0] * arm[1] - a[1] * arm[0],
        ]
    )


def _crossed_twice(w: Array, arm: Array) -> Array:
    along = w[0] * arm[0] + w[1] * arm[1] + w[2] * arm[2]
    square = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    return np.array([w[i] * along - square * arm[i] for i in range(3)])
