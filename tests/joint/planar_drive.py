"""A drive on a level road in closed form: truth that no code of the package made."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucald.mount.joint.evidence import Block

Array = NDArray[np.float64]
G = 9.80665
_AXIS = np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0)
_SKEW = np.cross(np.eye(3), _AXIS)
ROTATION = np.eye(3) + np.sin(0.6) * _SKEW + (1.0 - np.cos(0.6)) * _SKEW @ _SKEW
"""Vehicle from sensor: by 34 deg about (1, 2, 3)."""


class Sensor(NamedTuple):
    """How the triads answer in sensor axes: force = K R' f + b, rate = C R' w."""

    accel: Array = np.eye(3)
    gyro: Array = np.eye(3)
    zero: Array = np.zeros(3)


def blocks(
    minutes: float,
    sensor: Sensor,
    late_s: float = 0.0,
    seed: int = 0,
    lost: float = 0.0,
    bends: float = 1.0,
    squat: float = 0.0,
    brakes: float = 0.0,
) -> list[Block]:
    """Blocks of a car that speeds up, brakes and turns; noise of 0.05 m/s^2 on the force.

    late_s: the speed shows what it was so long ago. lost: share of ticks that are rubbish. bends:
    size of the turns. squat: by how much the body pitches, nose up, for each unit of dv/dt
    [rad s^2/m]. brakes: size of braking that is harder and shorter than the launches [m/s^2].
    """
    rng = np.random.default_rng(seed)
    n = int(minutes * 600) // 64 * 64
    t = np.arange(n) * 0.1

    def speed(at: Array) -> Array:
        return np.asarray(
            12.0
            + 5.0 * np.sin(0.31 * at)
            + 2.0 * np.sin(0.83 * at + 1.0)
            + np.sin(1.7 * at)
            - brakes * (np.sin(0.4 * at) / 0.4 + 0.5 * np.sin(0.8 * at) / 0.8)
        )

    def accel(at: Array) -> Array:
        return np.asarray(
            1.55 * np.cos(0.31 * at)
            + 1.66 * np.cos(0.83 * at + 1.0)
            + 1.7 * np.cos(1.7 * at)
            - brakes * (np.cos(0.4 * at) + 0.5 * np.cos(0.8 * at))
        )

    r = 0.12 * np.sin(0.23 * t) + 0.1 * np.sin(0.61 * t + 2.0) + 0.05 * np.sin(1.3 * t)
    r *= bends
    a, pitch = accel(t), squat * accel(t)
    pitching = squat * (accel(t + 1e-4) - accel(t - 1e-4)) / 2e-4
    c, s = np.cos(pitch), np.sin(pitch)
    force = np.column_stack([c * a + s * G, speed(t) * r, c * G - s * a])
    rate = np.column_stack([s * r, -pitching, c * r])
    f = force @ ROTATION @ sensor.accel.T + sensor.zero + rng.normal(0.0, 0.05, (n, 3))
    w = rate @ ROTATION @ sensor.gyro.T + rng.normal(0.0, 0.002, (n, 3))
    use = rng.random(n) >= lost
    f[~use], w[~use] = 30.0, w[~use]
    v = speed(t - late_s)
    return [
        Block(f[k : k + 64], w[k : k + 64], v[k : k + 64], use[k : k + 64]) for k in range(0, n, 64)
    ]


def cross_talk(matrix: Array, answer: Array) -> Array:
    """(3, 3) what a corrected triad keeps of the other axes [rad]."""
    return matrix @ answer @ ROTATION.T - np.eye(3)
