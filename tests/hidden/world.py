"""What is true on one drive: vehicle, road, sensors; and the baseline model file beside it.

The baseline is a correct model file: each parameter is right to within its tolerance. `World`
holds the true values; an effect then moves some of them (see `effects`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hidden.numerics import Array, mount_matrix, stream, turn

DEG = np.pi / 180.0

TOLERANCES: Mapping[str, float] = {
    "mount.rotation": 0.2 * DEG,
    "mount.lever_arm_m": 0.1,
    "accel.bias": 0.03,
    "accel.scale": 0.003,
    "accel.cross_axis": 0.002,
    "accel.bias_temperature": 0.0008,
    "gyro.bias": 0.05 * DEG,
    "gyro.scale": 0.004,
    "gyro.cross_axis": 0.001,
    "gyro.bias_temperature": 0.002 * DEG,
    "gyro.g_sensitivity": 0.003 * DEG,
    "road.grade_rms": 0.15,
    "road.bank_rms": 0.15,
    "road.crown_mean": 0.003,
    "suspension.squat_gradient": 0.0005,
    "suspension.dive_gradient": 0.0005,
    "suspension.roll_gradient": 0.001,
    "steering.offset": 0.5 * DEG,
    "chassis.steering_ratio": 0.015,
    "chassis.understeer_gradient": 0.0003,
    "speed.scale": 0.005,
    "yaw_rate.scale": 0.006,
    "yaw_rate.offset": 0.05 * DEG,
    "lateral_accel.offset": 0.03,
    "lateral_accel.scale": 0.006,
    "delay_s": 0.008,
    "clock_drift_ppm": 50.0,
}
"""How far the truth may be from the baseline by honest ignorance: even spread, +- this; SI. The
first dots of a key are the model file's; `grade_rms`, `bank_rms` and `steering_ratio` relative."""

DELAYED = ("speed", "steering", "yaw_rate", "lateral_accel", "imu")
"""Units with a delay of their own; the stability control's frame counts as two sensors."""


@dataclass
class Channel:
    """How one signal comes: cycle, age, faults."""

    rate_hz: float
    delay_s: float = 0.01
    jitter_s: float = 0.0005
    loss: float = 0.0002
    cycle_ppm: float = 0.0
    stamps_ppm: float = 0.0
    """The stamps come from a clock that is slow or fast against the vehicle's."""
    lowpass_hz: float | None = None
    full_scale: float | None = None
    clipped_share: float = 0.0
    """Ask for a rail on which this share of the samples sits."""
    lost_share: float = 0.0
    frozen_share: float = 0.0


@dataclass
class Triad:
    """Errors of a three-axis sensor, in its own axes and SI units."""

    bias: Array
    scale: Array
    cross_axis: Array
    """xy, xz, yx, yz, zx, zy: the part of the second axis seen in the first."""
    bias_temperature: Array
    noise_density: float
    walk: float
    lsb: float
    vibration: Array
    """rms on each vehicle axis at 20 m/s."""
    g_sensitivity: Array = field(default_factory=lambda: np.zeros(3))
    rectification: Array = field(default_factory=lambda: np.zeros(3))
    """Mean shift per mean square of vibration [unit/(m/s^2)^2]."""


@dataclass
class World:
    """True values of everything; SI, radians, vehicle axes as ISO 8855."""

    seed: int
    # vehicle
    mass: float
    yaw_inertia: float
    wheelbase: float
    to_front: float
    track: float
    steering_ratio: float
    rear_stiffness: float
    understeer: float
    friction: float
    relaxation_m: float
    hands_lag_s: float
    squat: float
    dive: float
    roll_gradient: float
    pitch_hz: float
    roll_hz: float
    heave_hz: float
    damping: float
    slip_per_mps2: float
    # road
    grade_rms: float
    grade_length: float
    bank_rms: float
    bank_length: float
    crown: float
    roughness_n0: float
    # place of the sensor
    R_vehicle_from_sensor: Array
    lever_arm: Array
    accel: Triad
    gyro: Triad
    channels: dict[str, Channel]
    # vehicle signals
    speed_scale: float
    wheel_scale: Array
    steering_offset: float
    yaw_scale: float
    yaw_offset: float
    lateral_scale: float
    lateral_offset: float
    start_degc: float
    rise_k: float
    engine: float
    shift_share: float | None = None
    """Part of the drive after which the mount is turned, or None."""
    shift: Array = field(default_factory=lambda: np.eye(3))
    """Turn about vehicle axes at the shift."""
    gusts: float = 0.0
    """rms side force of the wind, per mass [m/s^2]."""
    sway: float = 0.0
    """Amplitude of a swaying trailer's side force at the hitch, per mass [m/s^2]."""
    slosh_mass: float = 0.0
    """Share of the mass that swings sideways."""
    slosh_hz: float = 0.55


def honest_world(seed: int) -> tuple[World, dict[str, Any]]:
    """Draw a vehicle with its sensors, and the model file that describes it honestly."""
    model = _baseline(seed)
    rng = stream(seed, "truth")

    def off(key: str, n: int | None = None) -> Any:
        return TOLERANCES[key] * rng.uniform(-1.0, 1.0, n)

    chassis, suspension, mount = model["chassis"], model["suspension"], model["mount"]
    angles = [mount[f"{name}_deg"] * DEG for name in ("roll", "pitch", "yaw")]
    axis_turn = off("mount.rotation", 3)
    size = float(np.linalg.norm(axis_turn))
    R = turn(axis_turn / size, size) @ mount_matrix(*angles)
    speed_scale = float(off("speed.scale"))
    world = World(
        seed=seed,
        mass=1450.0 * float(rng.uniform(0.92, 1.12)),
        yaw_inertia=2300.0 * float(rng.uniform(0.9, 1.15)),
        wheelbase=chassis["wheelbase_m"],
        to_front=chassis["cg_to_front_m"] + float(rng.uniform(-0.04, 0.04)),
        track=1.53,
        steering_ratio=chassis["steering_ratio"] * (1.0 + float(off("chassis.steering_ratio"))),
        rear_stiffness=chassis["rear_cornering_stiffness_npr"] * float(rng.uniform(0.92, 1.08)),
        understeer=chassis["understeer_gradient"] + float(off("chassis.understeer_gradient")),
        friction=float(rng.uniform(0.85, 1.0)),
        relaxation_m=float(rng.uniform(0.2, 0.4)),
        hands_lag_s=float(rng.uniform(0.01, 0.025)),
        squat=suspension["squat_gradient"] + float(off("suspension.squat_gradient")),
        dive=suspension["dive_gradient"] + float(off("suspension.dive_gradient")),
        roll_gradient=suspension["roll_gradient"] + float(off("suspension.roll_gradient")),
        pitch_hz=float(rng.uniform(1.5, 1.9)),
        roll_hz=float(rng.uniform(1.6, 2.0)),
        heave_hz=float(rng.uniform(1.25, 1.5)),
        damping=float(rng.uniform(0.28, 0.4)),
        slip_per_mps2=float(rng.uniform(0.0005, 0.0015)),
        grade_rms=model["road"]["grade_rms"] * (1.0 + float(off("road.grade_rms"))),
        grade_length=110.0 * float(rng.uniform(0.85, 1.15)),
        bank_rms=model["road"]["bank_rms"] * (1.0 + float(off("road.bank_rms"))),
        bank_length=60.0 * float(rng.uniform(0.85, 1.15)),
        crown=model["road"]["crown_mean"] + float(off("road.crown_mean")),
        roughness_n0=16e-6 * 2.0 ** float(rng.uniform(-0.5, 3.0)),
        R_vehicle_from_sensor=R,
        lever_arm=np.array(mount["lever_arm_m"]) + off("mount.lever_arm_m", 3),
        accel=_accelerometer(rng, off),
        gyro=_gyroscope(rng, off),
        channels=_channels(rng, model, off),
        speed_scale=speed_scale,
        wheel_scale=speed_scale + rng.uniform(-0.001, 0.001, 4),
        steering_offset=float(off("steering.offset")),
        yaw_scale=float(off("yaw_rate.scale")),
        yaw_offset=float(off("yaw_rate.offset")),
        lateral_scale=float(off("lateral_accel.scale")),
        lateral_offset=float(off("lateral_accel.offset")),
        start_degc=model["temperature"]["start_degc"],
        rise_k=float(rng.uniform(10.0, 25.0)),
        engine=float(rng.uniform(0.02, 0.1)),
    )
    return world, model


def _baseline(seed: int) -> dict[str, Any]:
    """Draw the model file: what is known of the vehicle before anything is measured."""
    rng = stream(seed, "baseline")

    def uniform(low: float, high: float) -> float:
        return round(float(rng.uniform(low, high)), 6)

    wheelbase, unit_delay = uniform(2.55, 2.85), uniform(0.009, 0.025)
    return {
        "chassis": {
            "wheelbase_m": wheelbase,
            "cg_to_front_m": round(wheelbase * uniform(0.43, 0.48), 6),
            "steering_ratio": uniform(14.0, 17.0),
            "rear_cornering_stiffness_npr": uniform(95e3, 130e3),
            "understeer_gradient": uniform(0.0020, 0.0030),
        },
        "suspension": {
            "squat_gradient": uniform(0.0030, 0.0042),
            "dive_gradient": uniform(0.0035, 0.0048),
            "roll_gradient": uniform(0.0065, 0.0095),
        },
        "road": {
            "grade_rms": 0.008,
            "grade_length_m": 110.0,
            "bank_rms": 0.006,
            "bank_length_m": 60.0,
            "crown_mean": 0.012,
        },
        "mount": {
            "roll_deg": uniform(-30.0, 30.0),
            "pitch_deg": uniform(-30.0, 30.0),
            "yaw_deg": uniform(-180.0, 180.0),
            "lever_arm_m": [uniform(-1.0, 1.0), uniform(-0.5, 0.5), uniform(-0.1, 0.7)],
        },
        "accel": {"delay_s": unit_delay, "loss": 0.0002, "lowpass_hz": 40.0},
        "gyro": {"delay_s": unit_delay, "loss": 0.0002, "lowpass_hz": 40.0},
        "speed": {"delay_s": uniform(0.01, 0.12), "loss": 0.0002},
        "wheel_speeds": {"delay_s": 0.01, "loss": 0.0002},
        "steering": {"delay_s": uniform(0.009, 0.04), "loss": 0.0002},
        "yaw_rate": {"delay_s": uniform(0.009, 0.04), "loss": 0.0002, "lowpass_hz": 15.0},
        "lateral_accel": {"delay_s": uniform(0.009, 0.04), "loss": 0.0002, "lowpass_hz": 15.0},
        "longitudinal_accel": {"delay_s": 0.01, "loss": 0.0002, "lowpass_hz": 15.0},
        "temperature": {"start_degc": uniform(5.0, 27.0)},
    }


def _accelerometer(rng: np.random.Generator, off: Any) -> Triad:
    return Triad(
        bias=off("accel.bias", 3),
        scale=off("accel.scale", 3),
        cross_axis=off("accel.cross_axis", 6),
        bias_temperature=off("accel.bias_temperature", 3),
        noise_density=float(rng.uniform(0.0010, 0.0030)),
        walk=1e-4 * float(rng.uniform(0.2, 1.0)),
        lsb=0.002,
        vibration=rng.uniform([0.05, 0.05, 0.08], [0.2, 0.2, 0.35]),
    )


def _gyroscope(rng: np.random.Generator, off: Any) -> Triad:
    return Triad(
        bias=off("gyro.bias", 3),
        scale=off("gyro.scale", 3),
        cross_axis=off("gyro.cross_axis", 6),
        bias_temperature=off("gyro.bias_temperature", 3),
        noise_density=float(rng.uniform(0.00008, 0.0002)),
        walk=2e-6,
        lsb=0.00035,
        vibration=np.full(3, rng.uniform(0.002, 0.006)),
        g_sensitivity=off("gyro.g_sensitivity", 3),
    )


def _channels(rng: np.random.Generator, model: dict[str, Any], off: Any) -> dict[str, Channel]:
    late = {name: float(off("delay_s")) for name in DELAYED}
    ppm = {name: float(off("clock_drift_ppm")) for name in DELAYED}

    def channel(name: str, rate: float, unit: str, **more: Any) -> Channel:
        return Channel(
            rate_hz=rate,
            delay_s=model[name]["delay_s"] + late[unit],
            cycle_ppm=ppm[{"lateral_accel": "yaw_rate"}.get(unit, unit)],
            jitter_s=float(rng.uniform(0.0002, 0.0010)),
            **more,
        )

    return {
        "accel": channel("accel", 100.0, "imu", lowpass_hz=40.0, full_scale=39.2),
        "gyro": channel("gyro", 100.0, "imu", lowpass_hz=40.0, full_scale=4.363323),
        "speed": channel("speed", 50.0, "speed"),
        "wheel_speeds": channel("wheel_speeds", 50.0, "speed"),
        "steering": channel("steering", 100.0, "steering"),
        "yaw_rate": channel("yaw_rate", 50.0, "yaw_rate", lowpass_hz=15.0),
        "lateral_accel": channel("lateral_accel", 50.0, "lateral_accel", lowpass_hz=15.0),
        "longitudinal_accel": channel("longitudinal_accel", 50.0, "lateral_accel", lowpass_hz=15.0),
        "reverse": Channel(10.0, 0.02),
        "brake": Channel(10.0, 0.02),
        "temperature": Channel(1.0, 0.0, loss=0.0),
    }
