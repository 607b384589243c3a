"""Drive along a path: speed, distance and intended curvature over time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucald.core.arrays import Array
from imucald.core.samples import GRAVITY
from imucald.model.vehicle import MAX_SPEED_MPS, DriveRoute
from imucald.simulation.filters import gauss_markov, generator, smoothed
from imucald.simulation.route import Path, build_path

JERK_WINDOW_S = 0.35
"""Width of each of two running means that limit the jerk to the jerk of drivers (2-6 m/s^3) [s]."""
STEERING_WINDOW_S = 0.2
"""Width of each of two running means that smooth the driver's steering in a bend [s]."""
BANKING_WINDOW_S = 0.5
"""Time over which superelevation changes [s]."""
SPEED_WANDER_S = 9.0
"""Correlation time of the variation of the driver's speed [s]."""
WANDER_GRID_S = 0.5
STEERING_WANDER_S = 0.8
CREEP_MPS = 0.2
"""Lowest mean speed between two nodes with standstill [m/s]."""
GRIP_SHARE = 0.6
"""Share of the road's friction that drivers use."""
STOP_SEARCHES = 3
"""Number of attempts to end the drive with a stop of the requested length."""
SHIFT_SPEEDS_MPS = (4.5, 8.5, 13.5, 19.0)
SHIFT_WIDTH_MPS = 0.12
SHIFT_MPS2 = 0.17
"""Acceleration during a gear shift [m/s^2]: the vehicle hardly accelerates. A change of 0.12 m/s at
0.17 m/s^2 takes 0.7 s."""
FADE_SPEED_MPS = 42.0
"""Speed at which the acceleration is zero, because of the engine's power [m/s]."""
EASE_SPEED_MPS = 4.0
"""Speed below which drivers gradually release the brake, to half at standstill [m/s]."""
DRIFT_GRID_S = 1.0
MIN_SPEED_FOR_WANDER = 6.0
"""Speed below which the curvature of steering corrections is limited [m/s]."""


@dataclass(frozen=True)
class Driving:
    """The driver's actions on the grid of the physics; all (N,).

    speed: signed, negative in reverse [m/s]. distance: driven path length, in both directions [m].
    """

    t: Array
    speed: Array
    acceleration: Array
    distance: Array
    curvature: Array
    banked_curvature: Array
    """Curvature of a superelevated road; 0 on other roads."""
    braking: Array


def drive_route(
    route: DriveRoute, seed: int, duration_s: float, rate: float, friction: float = 1.0
) -> Driving:
    """Drive a route for duration_s [s] on a time grid of `rate` [Hz].

    friction: friction of the road. On a slippery road, the driver uses smaller accelerations.
    """
    t = np.arange(round(duration_s * rate) + 1) / rate
    path = build_path(route, seed, duration_s)
    if path is None:
        zero = np.zeros(len(t))
        return Driving(t, zero, zero, zero, zero, zero, zero)
    path = _gentle(path, GRIP_SHARE * friction * GRAVITY)
    node_t, node_v, node_s, node_kappa, node_banked = _timed(path, route, seed, duration_s)
    speed = smoothed(np.interp(t, node_t, node_v), rate, JERK_WINDOW_S)
    speed[np.abs(speed) < 1e-6] = 0.0
    distance = _distance(t, speed, rate, node_t, node_s)
    curvature = smoothed(np.interp(distance, node_s, node_kappa), rate, STEERING_WINDOW_S)
    curvature += _steering_wander(route, seed, speed, rate)
    acceleration = np.gradient(speed) * rate
    travel = np.sign(speed)
    return Driving(
        t=t,
        speed=speed,
        acceleration=acceleration,
        distance=distance,
        curvature=curvature,
        banked_curvature=smoothed(np.interp(distance, node_s, node_banked), rate, BANKING_WINDOW_S),
        braking=((acceleration * travel < -0.4) | (speed == 0.0)).astype(float),
    )


def _gentle(path: Path, most: float) -> Path:
    """Return the same path with all accelerations limited to `most` [m/s^2]."""
    return replace(
        path,
        lateral_mps2=np.minimum(path.lateral_mps2, most),
        launch_mps2=np.minimum(path.launch_mps2, most),
        braking_mps2=np.minimum(path.braking_mps2, most),
    )


def _timed(
    path: Path, route: DriveRoute, seed: int, duration_s: float
) -> tuple[Array, Array, Array, Array, Array]:
    """Return times, signed speeds, distances, curvatures and superelevated curvatures of the nodes.
    A stop has two nodes."""
    moving_start = route.standing_first_s <= 0.0
    limit = _limits(path, route, seed)
    v = _profile(path, limit, moving_start, route.gear_shifts)
    node_t = _node_times(path, v, route.standing_first_s)
    target = duration_s - route.standing_last_s
    for _ in range(STOP_SEARCHES if route.standing_last_s > 0.0 else 0):
        last = int(np.searchsorted(node_t, target))
        if not 1 < last < len(v):
            break
        if path.stop_s[last - 1] > 0.0:
            last -= 1  # no second stop one metre after a stop
        path = Path(*(getattr(path, name)[: last + 1] for name in Path.__dataclass_fields__))
        limit = limit[: last + 1]
        limit[last] = 0.0
        v = _profile(path, limit, moving_start, route.gear_shifts)
        node_t = _node_times(path, v, route.standing_first_s)
        # Braking takes time, so the driver must stop earlier by this time.
        target -= max(0.0, float(node_t[-1]) - (duration_s - route.standing_last_s))
    s = np.concatenate(([0.0], np.cumsum(path.step)[:-1]))
    signed = v * path.direction
    stops = np.flatnonzero(path.stop_s > 0.0)
    left = node_t[stops] + path.stop_s[stops]
    order = np.insert(np.arange(len(v)), stops + 1, stops)
    times = np.insert(node_t, stops + 1, left)
    banked = path.curvature * path.banked
    return times, signed[order], s[order], path.curvature[order], banked[order]


def _limits(path: Path, route: DriveRoute, seed: int) -> Array:
    """Return the speed limit at each node [m/s], from the target speed with the driver's variation,
    bends and stops."""
    rng = generator(seed, "speed_wander")
    planned = np.cumsum(path.step / path.target_mps)
    n = int(planned[-1] / WANDER_GRID_S) + 2
    wander = gauss_markov(rng, n, WANDER_GRID_S, SPEED_WANDER_S)
    wander = np.interp(planned, np.arange(n) * WANDER_GRID_S, wander)
    limit = path.target_mps * np.clip(1.0 + route.speed_wander * wander, 0.6, 1.3)
    limit = np.minimum(limit, MAX_SPEED_MPS)
    bend = np.sqrt(path.lateral_mps2 / np.maximum(np.abs(path.curvature), 1e-6))
    result: Array = np.minimum(limit, bend)
    result[path.stop_s > 0.0] = 0.0
    return result


def _profile(path: Path, limit: Array, moving_start: bool, gear_shifts: bool) -> Array:
    """Return the highest speed (N,) within the limits, and within the allowed braking and
    acceleration at each node."""
    v2 = (limit * limit).tolist()
    two_step = (2.0 * path.step).tolist()
    braking = path.braking_mps2.tolist()
    if not moving_start:
        v2[0] = 0.0
    ease2 = EASE_SPEED_MPS**2
    after = v2[-1]
    for k in range(len(v2) - 2, -1, -1):
        ease = 1.0 if after >= ease2 else 0.5 + 0.5 * (after / ease2) ** 0.5
        reach = after + two_step[k] * braking[k] * ease
        if v2[k] > reach:
            v2[k] = reach
        after = v2[k]
    launch = path.launch_mps2.tolist()
    shifts = SHIFT_SPEEDS_MPS if gear_shifts else ()
    before = v2[0]
    for k in range(1, len(v2)):
        v = before**0.5
        gain = max(launch[k] * (1.0 - v / FADE_SPEED_MPS), 0.1)
        for at in shifts:
            if at <= v < at + SHIFT_WIDTH_MPS:
                gain = SHIFT_MPS2
        reach = before + two_step[k - 1] * gain
        if v2[k] > reach:
            v2[k] = reach
        before = v2[k]
    profile: Array = np.sqrt(np.maximum(v2, 0.0))
    return profile


def _node_times(path: Path, v: Array, start_s: float) -> Array:
    """Return the arrival time at each node [s]. Between two nodes, the speed is linear in time."""
    dt = 2.0 * path.step[:-1] / np.maximum(v[:-1] + v[1:], CREEP_MPS)
    dt = dt + path.stop_s[:-1]
    return start_s + np.concatenate(([0.0], np.cumsum(dt)))


def _distance(t: Array, speed: Array, rate: float, node_t: Array, node_s: Array) -> Array:
    """Return the integral of the speed [m], corrected at the nodes so that bends and stops keep
    their places."""
    step = np.abs(speed) / rate
    driven = np.cumsum(step) - 0.5 * (step + step[0])
    coarse = np.arange(0.0, t[-1] + DRIFT_GRID_S, DRIFT_GRID_S)
    drift = np.interp(coarse, node_t, node_s) - np.interp(coarse, t, driven)
    result: Array = np.maximum.accumulate(driven + np.interp(t, coarse, drift))
    return result


def _steering_wander(route: DriveRoute, seed: int, speed: Array, rate: float) -> Array:
    """Return small steering corrections of the driver as curvature (N,) [1/m]."""
    if route.steering_wander_mps2 == 0.0:
        return np.zeros(len(speed))
    rng = generator(seed, "steering_wander")
    accel = route.steering_wander_mps2 * gauss_markov(
        rng, len(speed), 1.0 / rate, STEERING_WANDER_S
    )
    v = np.abs(speed)
    # At standstill the driver holds the wheel still, so the corrections fade out with the speed.
    wander: Array = accel / np.maximum(v, MIN_SPEED_FOR_WANDER) ** 2
    return wander * np.minimum(v / MIN_SPEED_FOR_WANDER, 1.0)
