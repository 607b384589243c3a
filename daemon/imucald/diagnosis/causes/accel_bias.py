"""Accelerometer bias: a constant on each axis of the sensor."""

from __future__ import annotations

from imucald.diagnosis.cause import Cause, Parameter, Values
from imucald.diagnosis.state import State

KEYS = tuple(f"accel.bias.{i}" for i in range(3))


class AccelBias(Cause):
    """measured = true + bias, in sensor axes."""

    name = "accel_bias"
    parameters = tuple(Parameter(key, "m/s^2", 0.03, 0.3, 0.01) for key in KEYS)
    signals = ("accel_x", "accel_y", "accel_z")
    seen_by = "drive the same road in both directions and corner both ways"
    sentence = "The accelerometer reads a constant too much."

    def offset(self, s: State, p: Values) -> None:
        """Add the bias."""
        for i, key in enumerate(KEYS):
            s.accel[i] += p[key]
