"""Random content of model files, for tests that need every term at once."""

from __future__ import annotations

import random
from typing import Any


def random_terms(rng: random.Random) -> dict[str, Any]:
    """A model with any of the terms that can be taken out, some of them, of any sensible size."""

    def three(size: float) -> list[float]:
        return [rng.uniform(-size, size) for _ in range(3)]

    def triad(bias: float, full_scale: float) -> dict[str, Any]:
        return {
            "bias": three(bias),
            "bias_temperature": three(0.01 * bias),
            "scale": three(0.1),
            "cross_axis": three(0.08) + three(0.08),
            "delay_s": rng.choice([0.0, 0.03, 0.4]),
            "lowpass_hz": rng.choice([None, 3.0, 40.0]),
            "full_scale": full_scale,
            "lsb": 0.002,
        }

    def scalar() -> dict[str, Any]:
        return {
            "offset": rng.uniform(-0.1, 0.1),
            "scale": rng.uniform(-0.1, 0.1),
            "delay_s": rng.choice([0.0, 0.07, 0.3]),
        }

    model: dict[str, Any] = {
        "accel": triad(0.5, 39.2),
        "gyro": {**triad(0.05, 4.36), "g_sensitivity": three(0.004)},
        "mag": {"hard_iron_t": three(1e-5)},
        "speed": {"scale": rng.uniform(-0.1, 0.1), "delay_s": rng.choice([0.0, 0.1, 0.45])},
        "wheel_speeds": {"scale": [*three(0.1), 0.03], "delay_s": 0.05},
        "steering": scalar(),
        "yaw_rate": scalar(),
        "lateral_accel": scalar(),
        "longitudinal_accel": scalar(),
        "mount": {"lever_arm_m": three(3.0)},
        "suspension": {
            "squat_gradient": rng.uniform(0.0, 0.015),
            "dive_gradient": rng.uniform(0.0, 0.015),
            "roll_gradient": rng.uniform(-0.005, 0.03),
            "pitch_frequency_hz": rng.uniform(1.0, 3.0),
        },
        "road": {"crown_mean": rng.uniform(0.0, 0.03)},
    }
    for section in rng.sample(sorted(model), rng.randint(0, len(model) - 1)):
        del model[section]
    return model
