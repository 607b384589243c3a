"""Draw the random parameters of a drive: a different car, sensor, road and mount for each seed."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from imucald.core.samples import GRAVITY, LATERAL_ACCEL, LONGITUDINAL_ACCEL, TEMPERATURE
from imucald.model.model import VehicleModel, model_from_mapping
from imucald.model.vehicle import RouteKind
from imucald.simulation.filters import generator

MILLI_G = GRAVITY / 1000.0
ACCEL_BIAS_MPS2 = 10.0 * MILLI_G
"""rms of the accelerometer bias on each axis [m/s^2]."""
GYRO_BIAS_RADPS = math.radians(0.3)
SLOPE_RMS = 0.02
"""rms of grade and cross fall (tangents), including the mean crown."""
CROWN_MEAN, CROWN_SPREAD = 0.012, 0.006
MAX_DELAY_S = 0.3
MAX_TILT_DEG = 30.0
UPSIDE_DOWN_SHARE = 0.1
STYLE = (0.65, 1.05)
"""Range of the factor on all accelerations, from calm to sporty drivers."""


def random_model(
    seed: int,
    route: RouteKind = "mixed",
    *,
    standing_first: bool | None = None,
    cross_axis: float = 0.0,
    upside_down: bool | None = None,
    max_tilt_deg: float = MAX_TILT_DEG,
) -> VehicleModel:
    """Return a model whose random parameters are all drawn from the seed.

    standing_first, upside_down: given by the caller; None: drawn (True in half and in one tenth of
    the drives). cross_axis: rms of the accelerometer's cross-axis errors, 0.005 for half a percent.
    """
    rng = generator(seed, "random_model")

    def vector(rms: float) -> list[float]:
        return [float(x) for x in rms * rng.standard_normal(3)]

    def uniform(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    crown = float(np.clip(rng.normal(CROWN_MEAN, CROWN_SPREAD), -0.005, 0.03))
    # The wandering part has the rest of the rms after the mean and its spread.
    wander = math.sqrt(SLOPE_RMS**2 - CROWN_MEAN**2 - CROWN_SPREAD**2)
    upside = bool(rng.random() < UPSIDE_DOWN_SHARE)
    standing = bool(rng.random() < 0.5)
    standing_s = uniform(5.0, 40.0)
    roll, pitch = (uniform(-max_tilt_deg, max_tilt_deg) for _ in range(2))
    if upside if upside_down is None else upside_down:
        roll += 180.0 if roll < 0.0 else -180.0
    style = float(generator(seed, "style").uniform(*STYLE))
    if standing_first is not None:
        standing = standing_first
    data: dict[str, Any] = {
        "route": {
            "kind": route,
            "standing_first_s": standing_s if standing else 0.0,
            "driving_side": "right",
            "launch_mps2": [style * x for x in (0.8, 2.5)],
            "braking_mps2": [style * x for x in (0.8, 3.3)],
            "lateral_mps2": [style * x for x in (1.3, 3.6)],
        },
        "chassis": {
            "understeer_gradient": uniform(0.0015, 0.0045),
            "steering_ratio": uniform(13.0, 17.5),
            "wheelbase_m": uniform(2.5, 2.9),
            "rear_cornering_stiffness_npr": uniform(85e3, 140e3),
        },
        "suspension": {
            "squat_gradient": uniform(0.0020, 0.0055),
            "dive_gradient": uniform(0.0025, 0.0060),
            "roll_gradient": uniform(0.0045, 0.0110),
            "pitch_frequency_hz": uniform(1.4, 2.0),
            "roll_frequency_hz": uniform(1.4, 2.2),
        },
        "road": {
            "grade_rms": SLOPE_RMS,
            "grade_length_m": uniform(40.0, 140.0),
            "crown_mean": crown,
            "bank_rms": wander,
            "bank_length_m": uniform(25.0, 80.0),
            "superelevation": uniform(0.0, 0.5),
            "roughness_n0": 16e-6 * 2.0 ** uniform(0.0, 3.0),
        },
        "mount": {
            "roll_deg": roll,
            "pitch_deg": pitch,
            "yaw_deg": uniform(-180.0, 180.0),
            "lever_arm_m": [uniform(-1.5, 1.5), uniform(-0.6, 0.6), uniform(-0.2, 0.9)],
        },
    }
    accel_delay = uniform(0.0, 0.05)
    data["accel"] = {
        "bias": vector(ACCEL_BIAS_MPS2),
        "bias_temperature": vector(0.2 * MILLI_G),
        "bias_walk": 0.002 * MILLI_G,
        "scale": vector(0.003),
        "cross_axis": [float(x) for x in cross_axis * rng.standard_normal(6)],
        "noise_density": uniform(0.0008, 0.003),
        "delay_s": accel_delay,
        "vibration_mps2": [uniform(0.05, 0.25), uniform(0.05, 0.25), uniform(0.05, 0.40)],
        "engine_mps2": uniform(0.02, 0.1),
        "clock_drift_ppm": uniform(-100.0, 100.0),
    }
    data["gyro"] = {
        "bias": vector(GYRO_BIAS_RADPS),
        "bias_temperature": vector(math.radians(0.005)),
        "bias_walk": math.radians(0.0005),
        "scale": vector(0.003),
        "g_sensitivity": vector(math.radians(0.01) / GRAVITY),
        "delay_s": accel_delay,
        "clock_drift_ppm": data["accel"]["clock_drift_ppm"],
    }
    speed_scale = 0.01 * float(rng.standard_normal())
    speed_delay = uniform(0.0, MAX_DELAY_S)
    data["speed"] = {"scale": speed_scale, "delay_s": speed_delay, "jitter_s": 0.001}
    data["wheel_speeds"] = {
        "scale": [float(speed_scale + x) for x in 0.002 * rng.standard_normal(4)],
        "delay_s": speed_delay,
    }
    data["steering"] = {
        "offset": math.radians(2.0) * float(rng.standard_normal()),
        "delay_s": uniform(0.0, 0.1),
    }
    data["yaw_rate"] = {
        "offset": GYRO_BIAS_RADPS * float(rng.standard_normal()),
        "scale": 0.01 * float(rng.standard_normal()),
        "delay_s": uniform(0.0, 0.15),
    }
    data[LATERAL_ACCEL.channel] = {"offset": 0.1 * float(rng.standard_normal())}
    data[LONGITUDINAL_ACCEL.channel] = {"offset": 0.1 * float(rng.standard_normal())}
    data[TEMPERATURE.channel] = {
        "start_degc": uniform(-5.0, 30.0),
        "rise_k": uniform(5.0, 25.0),
    }
    return model_from_mapping(data, f"random model {seed}")
