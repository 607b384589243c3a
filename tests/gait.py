"""Simulated walking with truth: a trunk that bobs, brakes and sways, and a terminal carried on it.

Nothing here comes from the code under test. Trunk (Winter, "Biomechanics and Motor Control of Human
Movement"; Zijlstra and Hof, Gait and Posture 18, 2003): vertical and fore-aft acceleration swing
at the step's frequency, sideways at half of it; the body is lowest, and accelerated upwards
most, in double support, and is braked after it. The terminal swings with leg or arm as a rigid body
on a lever: force and rate are those of its motion, by differences.
Axes: earth east, north, up; body right, forward, up; terminal x right, y upper edge, z out of the
screen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

GRAVITY = 9.80665
GRID_HZ = 400.0


@dataclass(frozen=True)
class Carrying:
    """How a terminal is carried.

    turns: intrinsic x, y, z turns of the terminal against the body [deg]. swing: about the body's
    right axis at stride frequency [deg], on a lever [m] hanging down. lead: of the fore-aft
    acceleration against the vertical at that place [deg].
    """

    name: str
    turns: tuple[float, float, float]
    swing_deg: float = 0.0
    yaw_swing_deg: float = 2.0
    lever_m: float = 0.0
    lead_deg: float = 95.0


CARRYINGS = (
    Carrying("in front, flat", (3.0, 0.0, 0.0), 1.0, 2.0, 0.0, 125.0),
    Carrying("in front, tilted", (35.0, 0.0, 0.0), 1.5, 2.0, 0.0, 120.0),
    Carrying("sideways, tilted", (25.0, 0.0, 90.0), 1.5, 2.0, 0.0, 120.0),
    Carrying("at the ear", (75.0, 0.0, 100.0), 1.0, 3.0, 0.0, 100.0),
    Carrying("shirt pocket", (85.0, 0.0, 180.0), 1.5, 2.5, 0.0, 95.0),
    Carrying("trouser pocket", (80.0, 0.0, 20.0), 11.0, 4.0, 0.25, 95.0),
    Carrying("swinging hand", (-70.0, 0.0, 80.0), 16.0, 6.0, 0.45, 100.0),
)


@dataclass(frozen=True)
class Walk:
    """Samples in terminal axes, SI units, at times t (N,), and what is true."""

    t: Array
    accel: Array
    gyro: Array
    mag: Array
    course: Array
    """Direction of travel, clockwise from north [rad]."""
    walking: NDArray[np.bool_]
    steps: int
    """Whole steps."""


def _turn(axis: int, angle: Array) -> Array:
    """(N, 3, 3) turns about one axis."""
    R = np.zeros((len(angle), 3, 3))
    a, b = (axis + 1) % 3, (axis + 2) % 3
    R[:, axis, axis] = 1.0
    R[:, a, a] = R[:, b, b] = np.cos(angle)
    R[:, a, b], R[:, b, a] = -np.sin(angle), np.sin(angle)
    return R


def _smooth(x: Array, seconds: float) -> Array:
    n = max(int(seconds * GRID_HZ), 1)
    padded = np.concatenate([np.full(n, x[0]), x, np.full(n, x[-1])])
    return np.convolve(padded, np.hanning(n) / np.hanning(n).sum(), "same")[n:-n]


def _wander(rng: np.random.Generator, n: int, time_s: float) -> Array:
    """Unit-rms smooth noise."""
    knots = np.arange(0.0, n / GRID_HZ + 2.0 * time_s, time_s)
    return np.interp(np.arange(n) / GRID_HZ, knots, rng.standard_normal(len(knots)))


def walk(
    carrying: Carrying,
    speed: float = 1.3,
    is_left: bool = False,
    seconds: float = 120.0,
    seed: int = 0,
    rate_hz: float = 50.0,
    turns_deg: tuple[float, ...] = (90.0, -45.0, 180.0, 30.0, -90.0),
    hard_iron_ut: float = 6.0,
    disturbance_ut: float = 3.0,
    gyro_bias_deg: float = 0.4,
) -> Walk:
    """Walk a route with turns, standing for 4 s at either end.

    is_left: carried on the left side: mirrored, and the other leg's step is the firmer one.
    """
    rng = np.random.default_rng(seed)
    n = int(seconds * GRID_HZ)
    t = np.arange(n) / GRID_HZ
    going = _smooth(((t > 4.0) & (t < seconds - 4.0)).astype(float), 1.0)
    course = _course(rng, t, seconds, turns_deg, going)
    rate = (1.15 + 0.52 * speed) * (1.0 + 0.025 * _wander(rng, n, 1.5))
    stepping = going > 0.5
    phase = 2.0 * np.pi * np.cumsum(np.where(stepping, rate, 0.0)) / GRID_HZ
    trunk = _trunk(phase, going * stepping, speed, carrying, is_left, rng)
    body = _turn(2, -course)
    R = body @ _placed(carrying, phase, going, is_left, rng)
    force = np.einsum("nij,nj->ni", body, trunk)
    if carrying.lever_m:
        hanging = R @ np.array(_lever(carrying))
        for i in range(3):
            force[:, i] += np.gradient(np.gradient(_smooth(hanging[:, i], 0.02))) * GRID_HZ**2
    force[:, 2] += GRAVITY
    return _sampled(
        t, R, force, course, stepping, int(phase[-1] // (2.0 * np.pi)), rng, rate_hz,
        hard_iron_ut, disturbance_ut, gyro_bias_deg,
    )  # fmt: skip


def _course(
    rng: np.random.Generator, t: Array, seconds: float, turns: tuple[float, ...], going: Array
) -> Array:
    course = np.full(len(t), float(rng.uniform(0.0, 360.0)))
    for i, turn in enumerate(turns):
        at = 4.0 + (seconds - 8.0) * (i + 1) / (len(turns) + 1)
        course += np.where(t > at, turn, 0.0)
    return np.radians(_smooth(course, 2.0) + 3.0 * going * _wander(rng, len(t), 4.0))


def _trunk(
    phase: Array,
    amount: Array,
    speed: float,
    carrying: Carrying,
    is_left: bool,
    rng: np.random.Generator,
) -> Array:
    """Acceleration of the body in its own axes, (N, 3) [m/s^2]; phase 0 is double support."""
    side = -1.0 if is_left else 1.0
    up = 1.9 * speed**1.4 / 1.3**1.4 * (1.0 + 0.08 * side * np.cos(0.5 * phase))
    lead = math.radians(carrying.lead_deg + rng.normal(0.0, 6.0))
    part = 0.55 + 0.05 * rng.standard_normal()
    shock = np.mod(phase, 2.0 * np.pi) / (2.0 * np.pi)
    heel = 1.5 * np.exp(-25.0 * shock) * np.sin(2.0 * np.pi * 7.0 * shock)
    return (
        np.column_stack(
            [
                0.45 * up * side * np.cos(0.5 * phase + 0.6) + 0.12 * up * np.cos(1.5 * phase),
                part * up * np.cos(phase + lead) + 0.15 * up * np.cos(2.0 * phase + 1.0),
                up * np.cos(phase) + 0.22 * up * np.cos(2.0 * phase - 0.7) + heel,
            ]
        )
        * amount[:, None]
    )


def _lever(carrying: Carrying) -> Array:
    """Lever in terminal axes: it hangs along the body's down axis at the mean attitude."""
    still = _turns(carrying.turns)
    return np.asarray(still.T @ np.array([0.0, 0.0, -carrying.lever_m]))


def _turns(turns: tuple[float, float, float]) -> Array:
    x, y, z = (np.array([math.radians(a)]) for a in turns)
    # first the turn about the vertical, then tilted about the right axis, then about the edge
    return (_turn(2, z) @ _turn(0, x) @ _turn(1, y))[0]


def _placed(
    carrying: Carrying, phase: Array, going: Array, is_left: bool, rng: np.random.Generator
) -> Array:
    """Terminal against body, (N, 3, 3): mean attitude, swing, a slow change of grip."""
    side = -1.0 if is_left else 1.0
    x, y, z = carrying.turns
    still = _turns((x + rng.normal(0.0, 2.0), y + rng.normal(0.0, 2.0), side * z))
    swing = np.radians(carrying.swing_deg) * going * np.sin(0.5 * phase + (0.3 + 1.57 * (side > 0)))
    yaw = np.radians(carrying.yaw_swing_deg) * going * side * np.sin(0.5 * phase)
    grip = np.radians(1.5) * _wander(rng, len(phase), 3.0)
    return _turn(2, yaw) @ _turn(0, swing + grip) @ still


def _sampled(
    t: Array,
    R: Array,
    force: Array,
    course: Array,
    walking: NDArray[np.bool_],
    steps: int,
    rng: np.random.Generator,
    rate_hz: float,
    hard_iron_ut: float,
    disturbance_ut: float,
    gyro_bias_deg: float,
) -> Walk:
    every = round(GRID_HZ / rate_hz)
    ahead = np.einsum("nji,njk->nik", R[:-1], R[1:])
    rate = 0.5 * GRID_HZ * np.column_stack(
        [ahead[:, 2, 1] - ahead[:, 1, 2], ahead[:, 0, 2] - ahead[:, 2, 0],
         ahead[:, 1, 0] - ahead[:, 0, 1]]
    )  # fmt: skip
    rate = np.vstack([rate, rate[-1]])
    field = np.array([0.0, 20.0, -44.0]) + disturbance_ut * np.column_stack(
        [_wander(rng, len(t), 2.5) for _ in range(3)]
    )
    n = len(t[::every])

    def seen(v: Array, noise: float) -> Array:
        local = np.einsum("nji,nj->ni", R, v)[::every]
        return np.asarray(local + noise * rng.standard_normal((n, 3)))

    bias = np.radians(gyro_bias_deg) * rng.standard_normal(3)
    return Walk(
        t[::every],
        seen(force, 0.05),
        rate[::every] + bias + np.radians(0.15) * rng.standard_normal((n, 3)),
        (seen(field, 0.6) + hard_iron_ut * rng.standard_normal(3) / math.sqrt(3.0)) * 1e-6,
        course[::every],
        walking[::every],
        steps,
    )
