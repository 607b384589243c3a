"""Gyroscope bias: a constant rate on each axis of the sensor."""

from __future__ import annotations

from imucald.diagnosis.cause import Cause, Parameter, Values
from imucald.diagnosis.state import State

KEYS = tuple(f"gyro.bias.{i}" for i in range(3))
DEG = 0.017453292519943295


class GyroBias(Cause):
    """measured = true + bias, in sensor axes."""

    name = "gyro_bias"
    parameters = tuple(Parameter(key, "rad/s", 0.05 * DEG, 0.5 * DEG, 0.05 * DEG) for key in KEYS)
    signals = ("gyro_x", "gyro_y", "gyro_z")
    needs = ("gyro",)
    seen_by = "stand still for a minute"
    sentence = "The gyroscope shows a rate at rest."

    def inputs(self, s: State, p: Values) -> None:
        """Take it off what the chain uses of the gyroscope."""
        if s.gyro_in is not None and any(p[key] for key in KEYS):
            s.gyro_in = s.gyro_in - [[p[key]] for key in KEYS]

    def offset(self, s: State, p: Values) -> None:
        """Add the bias."""
        for i, key in enumerate(KEYS):
            s.gyro[i] += p[key]
