"""Gyroscope that answers to specific force (g-sensitivity)."""

from __future__ import annotations

from collections.abc import Sequence

from imucald.diagnosis.cause import Cause, Parameter, Values, Variant
from imucald.diagnosis.state import State

KEYS = tuple(f"gyro.g_sensitivity.{i}" for i in range(3))
DEG = 0.017453292519943295


class GSensitivity(Cause):
    """measured_i = true_i + k_i * specific force on the same axis."""

    name = "g_sensitivity"
    parameters = tuple(
        Parameter(key, "(rad/s)/(m/s^2)", 0.003 * DEG, 0.06 * DEG, 0.01 * DEG) for key in KEYS
    )
    signals = ("gyro_x", "gyro_y", "gyro_z")
    needs = ("gyro",)
    seen_by = "brake and corner hard; turn the sensor over once at rest"
    sentence = "The gyroscope answers to acceleration."

    def variants(self) -> Sequence[Variant]:
        """One axis alone, or all of them."""
        single = [Variant(self.name, key[-1], (key,)) for key in KEYS]
        return (*single, Variant(self.name, "", KEYS))

    def inputs(self, s: State, p: Values) -> None:
        """Take it off what the chain uses of the gyroscope."""
        if s.gyro_in is not None and any(p[key] for key in KEYS):
            s.gyro_in = s.gyro_in - s.track.accel * [[p[key]] for key in KEYS]

    def offset(self, s: State, p: Values) -> None:
        """Add what the force makes; the predicted force stands for the felt one."""
        for i, key in enumerate(KEYS):
            if p[key]:
                s.gyro[i] += p[key] * s.track.accel[i]
