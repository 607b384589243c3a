"""Cross-axis errors: part of one axis of the accelerometer is seen in another."""

from __future__ import annotations

from collections.abc import Sequence

from imucald.diagnosis.cause import Cause, Parameter, Values, Variant
from imucald.diagnosis.state import State

KEYS = tuple(f"accel.cross_axis.{i}" for i in range(6))
PAIRS = ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))
"""Axis in which it is seen, and axis of which; the model file's order."""


class AccelCrossAxis(Cause):
    """measured_i = true_i + c_ij true_j, in sensor axes."""

    name = "accel_cross_axis"
    parameters = tuple(
        Parameter(
            key, "1", 0.005 if seen == 2 else 0.003, 0.04, 0.005, -0.5, 0.5, share=0.1, floor=1.0
        )
        for key, (seen, _) in zip(KEYS, PAIRS, strict=True)
    )
    signals = ("accel_x", "accel_y", "accel_z")
    seen_by = "brake and accelerate hard in a straight line, and corner hard both ways"
    sentence = "One axis of the accelerometer sees part of another."

    def variants(self) -> Sequence[Variant]:
        """One of the six, or all of them."""
        single = [Variant(self.name, key[-1], (key,)) for key in KEYS]
        return (*single, Variant(self.name, "", KEYS))

    def gain(self, s: State, p: Values) -> None:
        """Mix the axes."""
        before = s.accel.copy()
        for key, (seen, of) in zip(KEYS, PAIRS, strict=True):
            if p[key]:
                s.accel[seen] += p[key] * before[of]
