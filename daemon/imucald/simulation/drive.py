"""A simulated drive: samples as on a car's bus, and the true motion."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucald.core.arrays import Array
from imucald.core.errors import ConfigError
from imucald.core.rotations import Matrix3, angles_from_rotation, quaternion_from_rotation
from imucald.core.samples import Samples, Series
from imucald.model.model import VehicleModel
from imucald.model.section import ZERO
from imucald.simulation.body import (
    BodyAttitude,
    BodyMotion,
    body_motion,
    road_force,
    suspension_attitude,
)
from imucald.simulation.driver import Driving, drive_route
from imucald.simulation.filters import generator
from imucald.simulation.imu import accel_series, gyro_series, mounts
from imucald.simulation.road import RoadAttitude, road_attitude, road_roughness, slope_distance
from imucald.simulation.single_track import VehicleResponse, handle, steer_for
from imucald.simulation.vehicle_signals import VehicleSignals

MOVING_MPS = 1.0
"""Speed above which a time counts as driving, for means 'while driving' [m/s]."""


@dataclass(frozen=True)
class Truth:
    """True motion of a simulated drive. Arrays are (N,) at the regular times `t`, in SI and rad.

    Angles are ISO 8855 (pitch positive nose down, roll positive left side up). `road_*`: angles of
    the road plane relative to the horizontal. `body_*`: angles of the body relative to the road
    plane.
    """

    mounts: tuple[tuple[float, Matrix3], ...]
    """Pairs of a start time [s] and the R_vehicle_from_sensor that is valid from this time on."""
    lever_arm_m: tuple[float, float, float]
    t: Array
    speed: Array
    """Signed speed along the vehicle [m/s]."""
    acceleration: Array
    """Time derivative of `speed` [m/s^2]."""
    lateral_velocity: Array
    yaw_rate: Array
    """Yaw rate about the road's normal."""
    steer: Array
    """Road-wheel angle."""
    heading: Array
    """Heading clockwise from north, not wrapped."""
    road_pitch: Array
    road_roll: Array
    body_pitch: Array
    body_roll: Array
    force: NDArray[np.float64]
    """Specific force (N, 3) at the sensor's position, vehicle axes, without vibration."""
    reference_force: NDArray[np.float64]
    """Specific force (N, 3) at the body's centre of rotation."""
    rate: NDArray[np.float64]
    """Angular rate (N, 3), vehicle axes."""

    def R_vehicle_from_sensor(self, t: float | None = None) -> Matrix3:
        """Return the mount at a time [s]. Without a time, return the mount at the end of the
        drive."""
        reached = [R for start, R in self.mounts if t is None or start <= t]
        return reached[-1] if reached else self.mounts[0][1]

    def mean_crown(self, start_s: float = 0.0, stop_s: float = math.inf) -> float:
        """Return the mean roll of the road while driving [rad]. The roll of the mount cannot be
        separated from this mean."""
        return self._driving_mean(self.road_roll, start_s, stop_s)

    def mean_grade(self, start_s: float = 0.0, stop_s: float = math.inf) -> float:
        """Return the mean pitch of the road while driving [rad], positive downhill."""
        return self._driving_mean(self.road_pitch, start_s, stop_s)

    def _driving_mean(self, x: Array, start_s: float, stop_s: float) -> float:
        use = (np.abs(self.speed) > MOVING_MPS) & (self.t >= start_s) & (self.t < stop_s)
        return float(np.mean(x[use])) if use.any() else 0.0

    def summary(self) -> dict[str, object]:
        """Return the content of `truth.json`: plain numbers and lists."""
        return {
            "mount": _mount_summary(self.mounts[0][1]),
            "shifts": [{"t_s": t, "mount": _mount_summary(R)} for t, R in self.mounts[1:]],
            "lever_arm_m": list(self.lever_arm_m),
            "mean_crown_deg": math.degrees(self.mean_crown()),
            "mean_grade_deg": math.degrees(self.mean_grade()),
            "distance_m": float(np.sum(np.abs(self.speed)) * (self.t[1] - self.t[0])),
            "standing_share": float(np.mean(self.speed == 0.0)),
            "duration_s": float(self.t[-1]),
        }


@dataclass(frozen=True)
class Drive:
    """Samples of a drive, with its model, seed and truth."""

    samples: Samples
    truth: Truth
    model: VehicleModel
    seed: int

    @property
    def duration_s(self) -> float:
        """Duration of the drive [s]."""
        return float(self.truth.t[-1])

    def summary(self) -> dict[str, object]:
        """Return the content of `truth.json`: the truth with seed and model."""
        parameters = self.model.dump()
        return {"seed": self.seed, **self.truth.summary(), "model": parameters}


def simulate(model: VehicleModel, seed: int, minutes: float) -> Drive:
    """Simulate a drive. The same model, seed and duration give the same numbers.

    Times begin at 0. Samples are in sensor axes and SI units (see `imucald.core.samples`). Raises
    ConfigError for a duration below one second and for an infinite duration.
    """
    duration_s = 60.0 * minutes
    if not 1.0 <= duration_s < math.inf:
        raise ConfigError(
            f"a drive of {minutes:g} min is not possible: it must last at least a "
            "second and be finite"
        )
    rate = model.grid_hz
    driving = drive_route(model.route, seed, duration_s, rate, model.chassis.friction)
    banked = driving.speed * driving.speed * driving.banked_curvature
    passed = slope_distance(driving.speed, rate)
    road = road_attitude(model.road, model.route, seed, passed, banked, rate)
    steer = steer_for(model.chassis, driving.speed, driving.curvature, road.roll)
    handling = handle(model.chassis, driving.speed, steer, road.roll, rate)
    body_attitude, body = _body(model, seed, driving, handling, road)
    heading = _heading(seed, body, rate)
    placed = mounts(model.mount)
    samples: dict[str, Series] = {}
    if model.accel.enabled:
        samples["accel"] = accel_series(model, placed, body, driving.speed, seed)
    if model.gyro.enabled:
        samples["gyro"] = gyro_series(model, placed, body, driving.speed, seed)
    signals = VehicleSignals(model, seed, driving, handling, body)
    samples.update(signals.all())
    if model.heading.enabled:
        samples["heading"] = signals.heading(heading)
    if model.mag.enabled:
        samples["mag"] = signals.magnetometer(heading, road, body_attitude, placed)
    truth = _truth(model, driving, handling, road, body_attitude, body, heading)
    return Drive(samples, truth, model, seed)


def _body(
    model: VehicleModel, seed: int, driving: Driving, handling: VehicleResponse, road: RoadAttitude
) -> tuple[BodyAttitude, BodyMotion]:
    rate = model.grid_hz
    force = road_force(driving.speed, driving.acceleration, handling, road)
    roughness = road_roughness(
        model.road, model.chassis, model.suspension, seed, driving.speed, driving.distance, rate
    )
    body_attitude = suspension_attitude(model.suspension, force[0], force[1], roughness, rate)
    lever = model.mount.lever_arm_m if model.mount.lever_arm else ZERO
    return body_attitude, body_motion(force, handling, road, body_attitude, lever, rate)


def _heading(seed: int, body: BodyMotion, rate: float) -> Array:
    """Return the heading clockwise from north [rad]. The drive begins in a random direction."""
    start = float(generator(seed, "heading").uniform(0.0, 2.0 * np.pi))
    return start - np.cumsum(body.heading_rate) / rate


def _truth(
    model: VehicleModel,
    driving: Driving,
    handling: VehicleResponse,
    road: RoadAttitude,
    body_attitude: BodyAttitude,
    body: BodyMotion,
    heading: Array,
) -> Truth:
    every = max(1, round(model.grid_hz / model.accel.rate_hz))
    arrays: Mapping[str, Array] = {
        "t": driving.t,
        "speed": driving.speed,
        "acceleration": driving.acceleration,
        "lateral_velocity": handling.lateral_velocity,
        "yaw_rate": handling.yaw_rate,
        "steer": handling.steer,
        "heading": heading,
        "road_pitch": road.pitch,
        "road_roll": road.roll,
        "body_pitch": body_attitude.pitch,
        "body_roll": body_attitude.roll,
    }
    return Truth(
        mounts=tuple(mounts(model.mount)),
        lever_arm_m=model.mount.lever_arm_m if model.mount.lever_arm else ZERO,
        **{name: np.ascontiguousarray(x[::every]) for name, x in arrays.items()},
        force=np.column_stack([x[::every] for x in body.force]),
        reference_force=np.column_stack([x[::every] for x in body.reference_force]),
        rate=np.column_stack([x[::every] for x in body.rate]),
    )


def _mount_summary(R: Matrix3) -> dict[str, object]:
    roll, pitch, yaw = (math.degrees(angle) for angle in angles_from_rotation(R))
    return {
        "roll_deg": roll,
        "pitch_deg": pitch,
        "yaw_deg": yaw,
        "quaternion_wxyz": list(quaternion_from_rotation(R)),
    }
