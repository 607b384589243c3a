"""Gyroscope scale: each axis of the sensor reads a share too much."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imucald.diagnosis.cause import Cause, Parameter, Values, Variant
from imucald.diagnosis.state import State

KEYS = tuple(f"gyro.scale.{i}" for i in range(3))


class GyroScale(Cause):
    """measured = (1 + scale) * true, in sensor axes."""

    name = "gyro_scale"
    parameters = tuple(Parameter(key, "1", 0.006, 0.06, 0.005, -0.5, 1.0) for key in KEYS)
    signals = ("gyro_x", "gyro_y", "gyro_z")
    needs = ("gyro",)
    seen_by = "drive several full circles both ways"
    sentence = "The gyroscope's scale is off."

    def variants(self) -> Sequence[Variant]:
        """One axis alone, or all of them."""
        single = [Variant(self.name, key[-1], (key,)) for key in KEYS]
        return (*single, Variant(self.name, "", KEYS))

    def inputs(self, s: State, p: Values) -> None:
        """Take it off where the gyroscope stands for the vehicle's yaw rate.

        Its part in the lever arm's terms is left: they know the scale less well than anything.
        """
        if s.gyro_in is not None and s.yaw_in is None and any(p[key] for key in KEYS):
            s.gyro_in = s.gyro_in / np.array([[1.0 + p[key]] for key in KEYS])

    def gain(self, s: State, p: Values) -> None:
        """Scale the axes."""
        for i, key in enumerate(KEYS):
            s.gyro[i] *= 1.0 + p[key]
