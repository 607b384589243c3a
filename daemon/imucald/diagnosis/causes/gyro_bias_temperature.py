"""Gyroscope bias that goes with the sensor's temperature."""

from __future__ import annotations

import numpy as np

from imucald.diagnosis.cause import Cause, Parameter, Values
from imucald.diagnosis.state import State

KEYS = tuple(f"gyro.bias_temperature.{i}" for i in range(3))
DEG = 0.017453292519943295


class GyroBiasTemperature(Cause):
    """measured = true + k * (T - 25 degC), in sensor axes."""

    name = "gyro_bias_temperature"
    parameters = tuple(
        Parameter(key, "rad/s/K", 0.002 * DEG, 0.03 * DEG, 0.005 * DEG) for key in KEYS
    )
    signals = ("gyro_x", "gyro_y", "gyro_z")
    needs = ("gyro", "temperature")
    seen_by = "start with a cold sensor and drive until it is warm, with stops in between"
    sentence = "The gyroscope's bias drifts with temperature."

    def inputs(self, s: State, p: Values) -> None:
        """Take it off what the chain uses of the gyroscope."""
        if s.gyro_in is not None and s.warmth is not None and any(p[key] for key in KEYS):
            s.gyro_in = s.gyro_in - np.array([[p[key]] for key in KEYS]) * s.warmth

    def offset(self, s: State, p: Values) -> None:
        """Add the drift."""
        if s.warmth is None:
            return
        for i, key in enumerate(KEYS):
            if p[key]:
                s.gyro[i] += p[key] * s.warmth
