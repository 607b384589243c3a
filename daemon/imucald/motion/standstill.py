"""Definitions of "at rest": all thresholds side by side with their reasons, and the functions that
apply them.

The thresholds differ because the questions differ: whether the *signal* says zero, whether the
*sensor* feels only an engine at idle, and whether a mean rate at rest is the gyroscope's error or a
turn. The callers decide how long rest must last. The static test of method A is the published one
(`mount.method_a.static_test`); its limits are settings (`config.calibration`).
"""

from __future__ import annotations

import math

import numpy as np

from imucald.core.arrays import Array, Flags
from imucald.core.rotations import Vector
from imucald.core.samples import GRAVITY

# What a speed signal says ------------------------------------------------------------------

ZERO_SPEED = 0.05
"""A speed below this is standstill [m/s] where speeds are interpolated.

The limit is finer than the step of any bus, so only zero and its rounding pass.
"""
ZERO_SPEED_SMOOTHED = 0.1
"""The limit [m/s] for a speed that was averaged over its neighbours.

Noise about zero is below it; a step of a coarse signal in one neighbour is above it.
"""
ROLLING_SPEED = 0.5
"""A vehicle faster than this [m/s] rolls, so a sensor cannot repeat the same value all the time."""
DRIVING_SPEED = 1.0
"""Below this speed [m/s] wheels may turn unseen: inductive wheel sensors fall silent at 2-4
km/h.
"""

# What a sensor feels -----------------------------------------------------------------------

PARKED_FORCE_CHANGE = 0.12
PARKED_FORCE_STD = 0.06
PARKED_RATE_STD = 0.01
"""Without speed, only a vehicle as still as a parked one is at rest.

Limits: change of the mean force from tick to tick [m/s^2], and standard deviation over some seconds
of force [m/s^2] and rate [rad/s]. A smooth road at steady speed changes a tick's mean by more, an
engine at idle by less.
"""
STEADY_TICKS = 32
"""Ticks in each part of a block in which these limits are tested."""
PARKED_SAMPLE_STD = 0.05
PARKED_GRAVITY = 0.1
"""Limits of a parked vehicle for the attitude, which uses samples over a second.

Limits: standard deviation of the force, all axes together, and difference of the size of its mean
from gravity [m/s^2].
"""
IDLE_FORCE = 0.25
IDLE_RATE = 0.05
"""Largest distance of means of ticks from their mean at a speed of zero, force [m/s^2] and rate
[rad/s]: an engine runs and people get in.
"""
TIMES_NOISE = 4.0
"""Alternative to the limit of the force: this many times its noise from tick to tick, so that a
noisy sensor can rest too (4 standard deviations: 1 of 16,000 normal samples).
"""

# Whether a mean rate at rest is an error of the gyroscope ------------------------------------

MAX_GYRO_BIAS = 0.1
"""Limit of the joint estimator: 5.7 deg/s.

Beyond it [rad/s] the vehicle itself turns: a speed stuck at zero is no rest. Zero-rate offsets of
consumer gyroscopes are some deg/s (BMI160: 3 deg/s).
"""
MAX_ZERO_OFFSET = math.radians(5.0)
"""Limit of method A, where the mean is taken tick by tick [rad/s]: a larger mean is a turntable or
a ferry and not an offset.
"""
MAX_TERMINAL_BIAS = math.radians(1.5)
"""Limit for a carried terminal [rad/s].

No speed shows that it rests, so a larger mean is a slow turn.
"""
TERMINAL_RATE_RANGE = math.radians(2.0)
"""Largest range of any axis of a terminal's gyroscope within a second at rest [rad/s]."""


def is_parked(force: Array, rate: Array | None) -> Flags:
    """Return where ticks (N, 3) of force [m/s^2] and rate [rad/s] are those of a parked vehicle,
    without speed.

    N: a multiple of `STEADY_TICKS`.
    """
    move = np.abs(np.diff(force, axis=0, prepend=force[:1])).max(axis=1)
    still: Flags = move < PARKED_FORCE_CHANGE
    still &= keeps_steady(force, PARKED_FORCE_STD, STEADY_TICKS)
    if rate is not None:
        still &= keeps_steady(rate, PARKED_RATE_STD, STEADY_TICKS)
    return still


def feels_parked(variance: float, size: float) -> bool:
    """Return whether a second's force is that of a parked vehicle, by its variance and the size of
    its mean.

    variance: sum over all axes [(m/s^2)^2]; size [m/s^2].
    """
    return variance < PARKED_SAMPLE_STD**2 and abs(size - GRAVITY) < PARKED_GRAVITY


def is_terminal_at_rest(spread: float, mean: Vector) -> bool:
    """Return whether a second's rates are those of a terminal at rest, by the largest range and
    their mean.
    """
    return spread < TERMINAL_RATE_RANGE and max(map(abs, mean)) < MAX_TERMINAL_BIAS


def keeps_steady(x: Array, limit: float, ticks: int) -> Flags:
    """Return where signals (N, axes) stay within a standard deviation, for parts of this many
    ticks.
    """
    spread = x.reshape(-1, ticks, x.shape[1]).std(axis=1).max(axis=1)
    return np.repeat(spread < limit, ticks)


def is_idle(rate: Array, force: Array) -> bool:
    """Return whether rates and forces (N, 3) at a speed of zero are those of a vehicle at rest."""
    change = np.diff(force, axis=0)
    noise = np.sqrt(0.5 * (change * change).mean(axis=0))
    allowed = np.maximum(IDLE_FORCE, TIMES_NOISE * noise)
    quiet = np.abs(rate - rate.mean(axis=0)).max() < IDLE_RATE
    return bool(quiet and (np.abs(force - force.mean(axis=0)) < allowed).all())
