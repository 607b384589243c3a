"""Place and attitude of the sensor in space, and what an inertial sensor there feels.

Nothing is written as a term (no lever-arm, grade or Coriolis formula): the sensor's place in an
inertial frame is differentiated twice and gravity taken off; the attitude's increments give the
angular rate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hidden.numerics import GRAVITY, Array, cumulative, rotation_x, rotation_y, rotation_z
from hidden.road import Road
from hidden.vehicle import Body, Handling, lean
from hidden.world import World

UP = np.array([0.0, 0.0, GRAVITY])
LOAD_HEIGHT = 2.5
"""Of a swinging load above the roll axis, to that of the body: tanks sit high."""


@dataclass(frozen=True)
class Motion:
    """What is true at each moment, on the grid; (N,) or (N, 3), body axes."""

    force: Array
    """Specific force at the sensor [m/s^2]."""
    reference_force: Array
    """At the body's reference, where the vehicle's own sensors sit."""
    road_force: Array
    """At the reference in the axes of the road's plane: as if the body did not lean."""
    rate: Array
    """Angular rate [rad/s]."""
    heading: Array
    """Of the road frame, positive to the left, not wrapped [rad]."""
    position: Array
    """(N, 3) of the vehicle's reference [m]; z up."""
    body: Body


def move(world: World, speed: Array, road: Road, handling: Handling, rate: float) -> Motion:
    """Drive through space at `speed` (N,) [m/s], sideways and turning as handled."""
    step = 1.0 / rate
    pitch, roll = -road.slope, road.fall
    # The vehicle turns about the road's normal; the compass turns about the vertical.
    about_up = handling.yaw_rate + np.gradient(pitch, step) * np.sin(roll)
    heading = cumulative(about_up / (np.cos(pitch) * np.cos(roll)), step)
    R_earth_from_road = rotation_z(heading) @ rotation_y(pitch) @ rotation_x(roll)
    in_plane = np.column_stack([speed, handling.lateral_velocity, np.zeros(len(speed))])
    position = cumulative(_turned(R_earth_from_road, in_plane), step)
    felt = _back(R_earth_from_road, _second_difference(position, step) + UP)
    # A swinging load leans the body by how far it is from hanging still.
    from_still = felt[:, 1] + handling.load_pull
    sideways = felt[:, 1] - LOAD_HEIGHT * world.slosh_mass * from_still
    body = lean(world, felt[:, 0], sideways, road.wheels, rate)
    R_earth_from_body = R_earth_from_road @ rotation_y(body.pitch) @ rotation_x(body.roll)
    reference = position + body.heave[:, None] * R_earth_from_road[:, :, 2]
    place = reference + R_earth_from_body @ world.lever_arm
    return Motion(
        force=_back(R_earth_from_body, _second_difference(place, step) + UP),
        reference_force=_back(R_earth_from_body, _second_difference(reference, step) + UP),
        road_force=felt,
        rate=_rate_of(R_earth_from_body, step),
        heading=heading,
        position=position,
        body=body,
    )


def _turned(R: Array, v: Array) -> Array:
    return np.asarray((R @ v[:, :, None])[:, :, 0])


def _back(R: Array, v: Array) -> Array:
    """R^T v for each of (N, 3, 3), (N, 3)."""
    return np.asarray((v[:, None, :] @ R)[:, 0, :])


def _second_difference(x: Array, step: float) -> Array:
    result = np.empty_like(x)
    result[1:-1] = (x[2:] - 2.0 * x[1:-1] + x[:-2]) / step**2
    result[0], result[-1] = result[1], result[-2]
    return result


def _rate_of(R: Array, step: float) -> Array:
    """Angular rate (N, 3) in the turning frame: logarithm of what two steps turn it."""
    between = np.swapaxes(R[:-2], 1, 2) @ R[2:]
    skew = 0.5 * (between - np.swapaxes(between, 1, 2))
    v = np.column_stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]])
    sine = np.linalg.norm(v, axis=1)
    grow = np.where(sine > 1e-9, np.arcsin(np.minimum(sine, 1.0)) / np.maximum(sine, 1e-12), 1.0)
    result = np.empty((len(R), 3))
    result[1:-1] = v * grow[:, None] / (2.0 * step)
    result[0], result[-1] = result[1], result[-2]
    return result
