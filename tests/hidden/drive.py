"""A hidden drive: samples, the baseline model, and what is true."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hidden.driver import drive_course
from hidden.effects import Effect, hide
from hidden.motion import move
from hidden.numerics import Array, mount_angles, mount_matrix, stream
from hidden.road import Road, road_under
from hidden.sensors import Recorder
from hidden.vehicle import handle
from hidden.world import DEG, World, honest_world
from imucald.core.samples import Samples

GRID_HZ = 200.0
MOVING_MPS = 1.0

PARAMETERS: Mapping[str, tuple[str, ...]] = {
    "mount_rotation": ("mount.roll_deg", "mount.pitch_deg", "mount.yaw_deg",
                       "mount.rotation_deg.0", "mount.rotation_deg.1", "mount.rotation_deg.2"),
    "mount_shift": ("mount.shifts.t_s", "mount.shifts.rotation_deg.0",
                    "mount.shifts.rotation_deg.1", "mount.shifts.rotation_deg.2",
                    "mount.shifts.roll_deg", "mount.shifts.pitch_deg", "mount.shifts.yaw_deg"),
    "accel_bias": ("accel.bias.0", "accel.bias.1", "accel.bias.2"),
    "accel_scale": ("accel.scale.0", "accel.scale.1", "accel.scale.2"),
    "accel_cross_axis": tuple(f"accel.cross_axis.{i}" for i in range(6)),
    "gyro_bias": ("gyro.bias.0", "gyro.bias.1", "gyro.bias.2"),
    "gyro_scale": ("gyro.scale.0", "gyro.scale.1", "gyro.scale.2"),
    "gyro_bias_temperature": tuple(f"gyro.bias_temperature.{i}" for i in range(3)),
    "g_sensitivity": tuple(f"gyro.g_sensitivity.{i}" for i in range(3)),
    "lever_arm": tuple(f"mount.lever_arm_m.{i}" for i in range(3)),
    "road_grade": ("road.grade_rms",),
    "road_bank": ("road.bank_rms",),
    "squat_dive": ("suspension.squat_gradient", "suspension.dive_gradient"),
    "body_roll": ("suspension.roll_gradient",),
    "steering_offset": ("steering.offset",),
    "steering_ratio": ("chassis.steering_ratio",),
    "understeer": ("chassis.understeer_gradient",),
    "wheel_speed_scale": ("speed.scale",),
    "yaw_rate_scale": ("yaw_rate.scale",),
    "yaw_rate_offset": ("yaw_rate.offset",),
    "signal_delay": tuple(f"{n}.delay_s" for n in ("speed", "steering", "yaw_rate",
                                                   "lateral_accel", "accel", "gyro")),
    "sensor_lowpass": ("accel.lowpass_hz", "gyro.lowpass_hz", "yaw_rate.lowpass_hz"),
    "saturation": ("accel.full_scale", "gyro.full_scale", "yaw_rate.full_scale"),
    "dropouts": tuple(f"{n}.loss" for n in ("speed", "steering", "yaw_rate", "lateral_accel",
                                            "accel", "gyro")),
    "stuck_signal": tuple(f"{n}.stuck_share" for n in ("speed", "steering", "yaw_rate",
                                                       "lateral_accel", "accel", "gyro")),
    "clock_drift": ("accel.clock_drift_ppm", "gyro.clock_drift_ppm", "accel.stamps_ppm"),
}  # fmt: skip
"""What a cause's truth is told of. Keys of the model file, with indices; beside them:
`mount.rotation_deg` and `mount.shifts.rotation_deg`, rotation vectors about vehicle axes from the
baseline's mount, or from the mount before the shift; `stuck_share`, share of the time;
`stamps_ppm`, by which the inertial unit's stamps run fast against the vehicle's."""


@dataclass(frozen=True)
class HiddenDrive:
    """One drive. Arrays (N,) or (N, 3) are on the regular times `t`, vehicle axes, SI."""

    seed: int
    effects: tuple[Effect, ...]
    samples: Samples
    model: Mapping[str, Any]
    """The baseline model file, as parsed YAML."""
    parameters: Mapping[str, float]
    """True values by key: of the model file's parameters with all that is hidden.

    The road's `grade_rms` and `bank_rms` are those of the road that was driven, over its distance,
    `bank_rms` about its mean; `loss` and `full_scale` what came about.
    """
    truth: Mapping[str, Mapping[str, float]]
    """Hidden cause to its true parameters."""
    mounts: tuple[tuple[float, Array], ...]
    """From time [s] on, R_vehicle_from_sensor."""
    t: Array
    speed: Array
    """Signed."""
    heading: Array
    """Positive to the left."""
    position: Array
    force: Array
    """Specific force at the sensor, without vibration."""
    reference_force: Array
    """Specific force at the body's reference: what a sensor without a lever arm would feel."""
    road_force: Array
    """The same in the axes of the road's plane: what is felt when the body does not lean."""
    rate: Array
    slope: Array
    """[rad] positive uphill."""
    fall: Array
    """[rad] positive left side up."""
    body_pitch: Array
    body_roll: Array

    @property
    def R_vehicle_from_sensor(self) -> Array:
        """The mount at the end of the drive; (3, 3)."""
        return self.mounts[-1][1]


def hidden_drive(seed: int, effects: Sequence[Effect] = (), minutes: float = 25.0) -> HiddenDrive:
    """Make a drive from a seed, with effects hidden in it.

    Everything but the effects depends on the seed alone: the same seed without them is the same
    drive by the same driver in the same weather.
    """
    world, model = honest_world(seed)
    for i, effect in enumerate(effects):
        hide(world, effect, stream(seed, f"effect:{i}:{effect.cause}"))
    course = drive_course(stream(seed, "driver"), 60.0 * minutes, GRID_HZ)
    road = road_under(world, course.speed, GRID_HZ)
    handling = handle(world, course.speed, course.curvature, road.fall, GRID_HZ)
    motion = move(world, course.speed, road, handling, GRID_HZ)
    recorder = Recorder(world, course, handling, motion, GRID_HZ)
    samples = recorder.record()
    parameters = {**_parameters(world, model, road, course.speed), **recorder.realised}
    return HiddenDrive(
        seed=seed,
        effects=tuple(effects),
        samples=samples,
        model=model,
        parameters=parameters,
        truth={
            effect.cause: {
                key: parameters[key]
                for key in PARAMETERS.get(effect.cause, ())
                if key in parameters
            }
            for effect in effects
        },
        mounts=_mounts(world, 60.0 * minutes),
        t=course.t,
        speed=course.speed,
        heading=motion.heading,
        position=motion.position,
        force=motion.force,
        reference_force=motion.reference_force,
        road_force=motion.road_force,
        rate=motion.rate,
        slope=road.slope,
        fall=road.fall,
        body_pitch=motion.body.pitch,
        body_roll=motion.body.roll,
    )


def _mounts(world: World, seconds: float) -> tuple[tuple[float, Array], ...]:
    mounts = [(0.0, world.R_vehicle_from_sensor)]
    if world.shift_share is not None:
        mounts.append((world.shift_share * seconds, world.shift @ world.R_vehicle_from_sensor))
    return tuple(mounts)


def _parameters(
    world: World, model: Mapping[str, Any], road: Road, speed: Array
) -> dict[str, float]:
    """Every true value by key."""
    found: dict[str, float] = {
        "chassis.steering_ratio": world.steering_ratio,
        "chassis.understeer_gradient": world.understeer,
        "suspension.squat_gradient": world.squat,
        "suspension.dive_gradient": world.dive,
        "suspension.roll_gradient": world.roll_gradient,
        "steering.offset": world.steering_offset,
        "speed.scale": world.speed_scale,
        "yaw_rate.scale": world.yaw_scale,
        "yaw_rate.offset": world.yaw_offset,
        "lateral_accel.scale": world.lateral_scale,
        "lateral_accel.offset": world.lateral_offset,
        "road.crown_mean": world.crown,
    }
    _vector(found, "mount.lever_arm_m", world.lever_arm)
    for name, triad in (("accel", world.accel), ("gyro", world.gyro)):
        for what in ("bias", "scale", "cross_axis", "bias_temperature"):
            _vector(found, f"{name}.{what}", getattr(triad, what))
    _vector(found, "gyro.g_sensitivity", world.gyro.g_sensitivity)
    for name, channel in world.channels.items():
        found[f"{name}.delay_s"] = channel.delay_s
        found[f"{name}.clock_drift_ppm"] = channel.cycle_ppm
        found[f"{name}.stamps_ppm"] = channel.stamps_ppm
        if channel.lowpass_hz is not None:
            found[f"{name}.lowpass_hz"] = channel.lowpass_hz
        if channel.full_scale is not None:
            found[f"{name}.full_scale"] = channel.full_scale
    mount = model["mount"]
    stated = mount_matrix(*(mount[f"{name}_deg"] * DEG for name in ("roll", "pitch", "yaw")))
    R = world.R_vehicle_from_sensor
    _angles(found, "mount", R)
    _vector(found, "mount.rotation_deg", _rotation_vector(R @ stated.T) / DEG)
    if world.shift_share is not None:
        found["mount.shifts.t_s"] = world.shift_share * (len(speed) - 1) / GRID_HZ
        _angles(found, "mount.shifts", world.shift)
        _vector(found, "mount.shifts.rotation_deg", _rotation_vector(world.shift) / DEG)
    passed = np.abs(speed)
    found["road.grade_rms"] = _rms_over_distance(np.tan(road.slope), passed)
    fall = np.tan(road.fall)
    about = float(np.sum(fall * passed) / np.sum(passed))
    found["road.bank_rms"] = _rms_over_distance(fall - about, passed)
    return found


def _vector(found: dict[str, float], key: str, values: Array) -> None:
    for i, value in enumerate(values):
        found[f"{key}.{i}"] = float(value)


def _angles(found: dict[str, float], key: str, R: Array) -> None:
    for name, angle in zip(("roll", "pitch", "yaw"), mount_angles(R), strict=True):
        found[f"{key}.{name}_deg"] = angle / DEG


def _rotation_vector(R: Array) -> Array:
    """Rotation vector [rad] of a small or middling turn."""
    v = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine = float(np.linalg.norm(v))
    angle = float(np.arctan2(sine, 0.5 * (np.trace(R) - 1.0)))
    return np.asarray(v * (angle / sine)) if sine > 1e-12 else v


def _rms_over_distance(x: Array, passed: Array) -> float:
    return float(np.sqrt(np.sum(x * x * passed) / np.sum(passed)))
