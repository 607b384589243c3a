"""The road under the vehicle: slope, cross fall, and the roughness that excites the body."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imucald.core.arrays import Array
from imucald.core.samples import GRAVITY
from imucald.model.vehicle import Chassis, DriveRoute, Road, Suspension
from imucald.simulation.filters import bilinear, filtered, gauss_markov, generator, smoothed

REFERENCE_WAVENUMBER = 0.1
"""Reference wavenumber of ISO 8608 [cycles/m]."""
MIN_SLOPE_M = 7.0
"""Window length [m] of the running mean that smooths slope and cross fall. It is applied twice."""
MAX_ROUGHNESS_M = 100.0
"""Wavelength above which a wave belongs to slope and cross fall, not to roughness [m]."""
MAX_TILT_WAVE_M = 20.0
"""Wavelength above which a wave lifts both tracks equally [m]."""
SMOOTHER_FROM_MPS = 15.0
"""Speed in the effect that faster roads are smoother [m/s]. The spectral density of the roughness
is divided by 1 + (v / SMOOTHER_FROM_MPS)^2. The lengths of slopes are multiplied by the square root
of this divisor."""


@dataclass(frozen=True)
class RoadAttitude:
    """Attitude of the road plane, (N,) each, by ISO 8855: pitch positive nose down."""

    pitch: Array
    roll: Array
    pitch_rate: Array
    roll_rate: Array


@dataclass(frozen=True)
class Roughness:
    """Effect of the road's unevenness on the suspension, (N,) each."""

    pitch: Array
    """Angle of the road between the axles [rad], nose down."""
    roll: Array
    """Angle of the road between the wheels [rad], left side up."""
    heave_acceleration: Array
    """Vertical acceleration of the body [m/s^2]."""


def slope_distance(speed: Array, rate: float) -> Array:
    """Return the distance (N,) along which slopes are drawn [m]. On fast roads, this distance is
    shorter than the driven distance.

    Slopes of fast roads are longer, so that the vertical acceleration (v^2 times the change of
    slope) stays within the limits of road design.
    """
    step = np.abs(speed) / (rate * np.sqrt(1.0 + (speed / SMOOTHER_FROM_MPS) ** 2))
    passed: Array = np.cumsum(step)
    return passed


def road_attitude(
    road: Road, route: DriveRoute, seed: int, distance: Array, curve_accel: Array, rate: float
) -> RoadAttitude:
    """Return slope and cross fall along a distance [m], see `slope_distance`.

    curve_accel: (N,) speed^2 * curvature of superelevated road [m/s^2]; 0 on other roads.
    """
    length = float(distance[-1])
    grade, fall = np.zeros(len(distance)), np.zeros(len(distance))
    n = math.ceil(length) + 2
    nodes = np.arange(n, dtype=float)
    if road.grade:
        waves = _waves(seed, "grade", n, road.grade_length_m)
        grade = road.grade_mean + road.grade_rms * _spline(distance, nodes, waves)
    if road.bank:
        waves = _waves(seed, "bank", n, road.bank_length_m)
        fall = road.crown_mean + road.bank_rms * _spline(distance, nodes, waves)
        # The road falls towards the kerb. That is the right side in right-hand traffic, so the
        # vehicle's left side is up.
        if route.driving_side == "left":
            fall = -fall
        # The limit is smooth, because a kink would cause a shock to the body.
        most = max(road.superelevation_max, 1e-9)
        fall = fall - most * np.tanh(road.superelevation * curve_accel / (GRAVITY * most))
    pitch, roll = -np.arctan(grade), np.arctan(fall)
    return RoadAttitude(pitch, roll, np.gradient(pitch) * rate, np.gradient(roll) * rate)


def _waves(seed: int, name: str, n: int, length: float) -> Array:
    """Return random waves with rms 1, one value per metre. Waves shorter than a vehicle are left
    out, because they belong to the roughness."""
    waves = gauss_markov(generator(seed, name), n, 1.0, length)
    return smoothed(waves, 1.0, MIN_SLOPE_M)


def _spline(x: Array, nodes: Array, values: Array) -> Array:
    """Return the cubic (Catmull-Rom) interpolation between nodes at unit distance. The slope of the
    interpolation is continuous."""
    i = np.clip(x.astype(np.int64), 0, len(nodes) - 2)
    u = x - i
    y0, y1 = values[np.maximum(i - 1, 0)], values[i]
    y2, y3 = values[i + 1], values[np.minimum(i + 2, len(values) - 1)]
    half = 0.5 * u
    result: Array = y1 + half * (
        (y2 - y0) + u * ((2.0 * y0 - 5.0 * y1 + 4.0 * y2 - y3) + u * (3.0 * (y1 - y2) + y3 - y0))
    )
    return result


def road_roughness(
    road: Road,
    chassis: Chassis,
    suspension: Suspension,
    seed: int,
    speed: Array,
    distance: Array,
    rate: float,
) -> Roughness | None:
    """Return the excitation of the wheels by an ISO 8608 profile; None if the road is smooth.

    The slope of the profile is white noise over the distance, so its vertical velocity has the
    one-sided density (2 pi n0)^2 G(n0) |v| [(m/s)^2/Hz]. Left and right tracks are independent. The
    rear wheels follow the front wheels at the distance of the wheelbase.
    """
    if not road.roughness or road.roughness_n0 == 0.0 or distance[-1] <= 0.0:
        return None
    rng = generator(seed, "roughness")
    intensity = (2.0 * math.pi * REFERENCE_WAVENUMBER) ** 2 * road.roughness_n0 * np.abs(speed)
    intensity /= 1.0 + (speed / SMOOTHER_FROM_MPS) ** 2
    velocity = np.sqrt(0.5 * rate * intensity)
    n = len(speed)
    centre = velocity * rng.standard_normal(n) / math.sqrt(2.0)
    across = velocity * rng.standard_normal(n) * math.sqrt(2.0)
    behind = np.maximum(distance - chassis.wheelbase_m, 0.0)
    usual = 2.0 * math.pi * max(float(np.mean(np.abs(speed))), 1.0)
    front = _height(centre, rate, usual / MAX_ROUGHNESS_M)
    tilt = _height(across, rate, usual / MAX_TILT_WAVE_M)
    rear = np.interp(behind, distance, front)
    tilt = 0.5 * (tilt + np.interp(behind, distance, tilt))
    return Roughness(
        pitch=(rear - front) / chassis.wheelbase_m,
        roll=tilt / chassis.track_m,
        heave_acceleration=_quarter_car(suspension, 0.5 * (front + rear), rate),
    )


def _height(velocity: Array, rate: float, slowest: float) -> Array:
    """Return the height of the road from its vertical velocity, without the long waves that belong
    to the slope."""
    b, a = bilinear([0.0, 1.0], [slowest**2, 1.4 * slowest, 1.0], rate)
    return filtered(b, a, velocity, settled=False)


def _quarter_car(suspension: Suspension, height: Array, rate: float) -> Array:
    """Return the body acceleration (N,) from the road height [m]: two masses, a spring, a damper, a
    tyre.

    w is the body frequency, z its damping, mu the ratio of unsprung to sprung mass. t is the ratio
    of tyre stiffness to unsprung mass, chosen for the given wheel-hop frequency.
        Z_s/Z_r = t (2 z w s + w^2) / (D4 s^4 + D3 s^3 + D2 s^2 + D1 s + D0).
    """
    w = 2.0 * math.pi * suspension.heave_frequency_hz
    c, k = 2.0 * suspension.heave_damping * w, w * w
    mu = suspension.unsprung_ratio
    t = max((2.0 * math.pi * suspension.wheel_hop_hz) ** 2 - k / mu, k)
    denominator = [t * k, t * c, t + k + k / mu, c + c / mu, 1.0]
    b, a = bilinear([0.0, 0.0, t * k, t * c], denominator, rate)
    return filtered(b, a, height, settled=False)
