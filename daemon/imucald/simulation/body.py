"""The sprung body on the road: its attitude, its angular rate, and the specific force at a sensor.

Frames: earth (z up) -> road (yaw, slope, cross fall) -> body (suspension pitch and roll). Vehicle
axes are the axes of the body. At rest on a level road, the vehicle axes are the ISO 8855 axes. The
sensor is fixed to the body, so the mount is a rotation between sensor and *body*.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucald.core.arrays import Array
from imucald.core.samples import GRAVITY
from imucald.model.section import Vector3
from imucald.model.vehicle import Suspension
from imucald.simulation.filters import second_order
from imucald.simulation.road import RoadAttitude, Roughness
from imucald.simulation.single_track import VehicleResponse


@dataclass(frozen=True)
class BodyAttitude:
    """Attitude of the body relative to the road and its rates, (N,) each [rad, rad/s].
    heave_acceleration: [m/s^2]."""

    pitch: Array
    roll: Array
    pitch_rate: Array
    roll_rate: Array
    heave_acceleration: Array


@dataclass(frozen=True)
class BodyMotion:
    """Motion at the sensor's position in body axes: columns x, y, z, each (N,)."""

    force: tuple[Array, Array, Array]
    """Specific force at the sensor [m/s^2]."""
    rate: tuple[Array, Array, Array]
    """Angular rate [rad/s]."""
    reference_force: tuple[Array, Array, Array]
    """Specific force at the body's centre of rotation [m/s^2]."""
    heading_rate: Array
    """Angular rate of the road frame about the vertical [rad/s]."""


def road_force(
    speed: Array, acceleration: Array, handling: VehicleResponse, road: RoadAttitude
) -> tuple[Array, Array, Array]:
    """Return the specific force (a - g) at the origin of the road frame, in road axes [m/s^2].

    The velocity in road axes is (v, v_y, 0). The rotation of the road frame adds w x v to the
    derivative of this velocity.
    """
    r, vy = handling.yaw_rate, handling.lateral_velocity
    p, q = _road_rates(handling, road)[:2]
    cos_pitch = np.cos(road.pitch)
    fx = acceleration - r * vy - GRAVITY * np.sin(road.pitch)
    fy = handling.lateral_velocity_rate + r * speed + GRAVITY * cos_pitch * np.sin(road.roll)
    fz = p * vy - q * speed + GRAVITY * cos_pitch * np.cos(road.roll)
    return fx, fy, fz


def _road_rates(handling: VehicleResponse, road: RoadAttitude) -> tuple[Array, Array, Array, Array]:
    """Return the angular rate of the road frame in its own axes, and the heading rate (Euler
    kinematics)."""
    sin_roll, cos_roll = np.sin(road.roll), np.cos(road.roll)
    sin_pitch, cos_pitch = np.sin(road.pitch), np.cos(road.pitch)
    heading_rate = (handling.yaw_rate + road.pitch_rate * sin_roll) / (cos_pitch * cos_roll)
    p = road.roll_rate - heading_rate * sin_pitch
    q = road.pitch_rate * cos_roll + heading_rate * cos_pitch * sin_roll
    return p, q, handling.yaw_rate, heading_rate


def suspension_attitude(
    suspension: Suspension,
    force_x: Array,
    force_y: Array,
    roughness: Roughness | None,
    rate: float,
) -> BodyAttitude:
    """Return the response of the suspension to the specific force in road axes and to the road's
    unevenness."""
    n = len(force_x)
    pitch, roll = np.zeros(n), np.zeros(n)
    if suspension.squat_dive:
        drive, brake = np.maximum(force_x, 0.0), np.minimum(force_x, 0.0)
        pitch = -(suspension.squat_gradient * drive + suspension.dive_gradient * brake)
    if suspension.body_roll:
        roll = suspension.roll_gradient * force_y
    heave = np.zeros(n)
    if roughness is not None:
        pitch = pitch + roughness.pitch
        roll = roll + roughness.roll
        heave = roughness.heave_acceleration
    fp, zp = suspension.pitch_frequency_hz, suspension.pitch_damping
    fr, zr = suspension.roll_frequency_hz, suspension.roll_damping
    return BodyAttitude(
        pitch=second_order(pitch, rate, fp, zp),
        roll=second_order(roll, rate, fr, zr),
        pitch_rate=second_order(pitch, rate, fp, zp, derivative=True),
        roll_rate=second_order(roll, rate, fr, zr, derivative=True),
        heave_acceleration=heave,
    )


def body_motion(
    force: tuple[Array, Array, Array],
    handling: VehicleResponse,
    road: RoadAttitude,
    body_attitude: BodyAttitude,
    lever_arm: Vector3,
    rate: float,
) -> BodyMotion:
    """Rotate the force from road axes into body axes, and transfer it to the sensor's position.

    R_road_from_body = R_y(pitch) R_x(roll). f_sensor = f + w' x l + w x (w x l).
    """
    p, q, r, heading_rate = _road_rates(handling, road)
    fx, fy, fz = force
    fz = fz + body_attitude.heave_acceleration
    sp, cp = np.sin(body_attitude.pitch), np.cos(body_attitude.pitch)
    sr, cr = np.sin(body_attitude.roll), np.cos(body_attitude.roll)

    def into_body(x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
        x, z = cp * x - sp * z, sp * x + cp * z
        return x, cr * y + sr * z, cr * z - sr * y

    reference = into_body(fx, fy, fz)
    wx, wy, wz = into_body(p, q, r)
    wx = wx + body_attitude.roll_rate
    wy = wy + body_attitude.pitch_rate * cr
    wz = wz - body_attitude.pitch_rate * sr
    at_sensor = reference
    if any(lever_arm):
        at_sensor = _carried(reference, (wx, wy, wz), lever_arm, rate)
    return BodyMotion(at_sensor, (wx, wy, wz), reference, heading_rate)


def _carried(
    force: tuple[Array, Array, Array],
    w: tuple[Array, Array, Array],
    lever_arm: Vector3,
    rate: float,
) -> tuple[Array, Array, Array]:
    lx, ly, lz = lever_arm
    wx, wy, wz = w
    dx, dy, dz = (np.gradient(component) * rate for component in w)
    along = wx * lx + wy * ly + wz * lz
    square = wx * wx + wy * wy + wz * wz
    return (
        force[0] + dy * lz - dz * ly + wx * along - square * lx,
        force[1] + dz * lx - dx * lz + wy * along - square * ly,
        force[2] + dx * ly - dy * lx + wz * along - square * lz,
    )
