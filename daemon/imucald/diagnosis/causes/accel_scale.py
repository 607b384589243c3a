"""Accelerometer scale: each axis of the sensor reads a share too much."""

from __future__ import annotations

from collections.abc import Sequence

from imucald.diagnosis.cause import Cause, Parameter, Values, Variant
from imucald.diagnosis.state import State

KEYS = tuple(f"accel.scale.{i}" for i in range(3))


class AccelScale(Cause):
    """measured = (1 + scale) * true, in sensor axes."""

    name = "accel_scale"
    parameters = tuple(
        Parameter(key, "1", 0.003, 0.05, 0.005, -0.5, 1.0, share=0.1) for key in KEYS
    )
    signals = ("accel_x", "accel_y", "accel_z")
    seen_by = "brake and accelerate hard, and corner hard both ways; park once on its side slope"
    sentence = "The accelerometer's scale is off."

    def variants(self) -> Sequence[Variant]:
        """One axis alone, or all of them."""
        single = [Variant(self.name, key[-1], (key,)) for key in KEYS]
        return (*single, Variant(self.name, "", KEYS))

    def gain(self, s: State, p: Values) -> None:
        """Scale the axes."""
        for i, key in enumerate(KEYS):
            s.accel[i] *= 1.0 + p[key]
