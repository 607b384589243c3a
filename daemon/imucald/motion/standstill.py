"""Definitions of "at rest": all thresholds with their reasons, and the functions that apply them.

There are different thresholds for different questions. The first question is whether the *signal*
of the speed is zero. The second question is whether the *sensor* feels only an idling engine. The
third question is whether a mean rate at rest is a gyroscope error or a turn. The callers decide how
long rest must last. The static test of method A is the published test
(`mount.method_a.static_test`). The limits of the static test are settings (`config.calibration`).
"""

from __future__ import annotations

import math

import numpy as np

from imucald.core.arrays import Array, Flags
from imucald.core.rotations import Vector
from imucald.core.samples import GRAVITY

# What a speed signal says ------------------------------------------------------------------

ZERO_SPEED = 0.05
"""Speed below which the vehicle is at standstill [m/s], for interpolated speeds.

The limit is smaller than the step size of any bus, so only zero with its rounding error is below
the limit.
"""
ZERO_SPEED_SMOOTHED = 0.1
"""Speed below which the vehicle is at standstill [m/s], for a speed that was averaged over its
neighbours.

Noise about zero is below this limit. One step of a coarse signal in a neighbour is above this
limit.
"""
ROLLING_SPEED = 0.5
"""Speed above which a vehicle rolls [m/s]. A sensor in a rolling vehicle cannot repeat the same
value all the time."""
DRIVING_SPEED = 1.0
"""Speed below which wheels may turn without a signal [m/s]: inductive wheel sensors send no pulses
below 2 to 4 km/h.
"""

# What a sensor feels -----------------------------------------------------------------------

PARKED_FORCE_CHANGE = 0.12
PARKED_FORCE_STD = 0.06
PARKED_RATE_STD = 0.01
"""Limits of a vehicle at rest without a speed signal. Such a vehicle must be as still as a parked
vehicle.

The limits are the change of the mean force from tick to tick [m/s^2], and the standard deviations
of force [m/s^2] and rate [rad/s] over some seconds. On a smooth road at steady speed, the mean
force of a tick changes by more than this limit. With an idling engine, the mean force changes by
less.
"""
STEADY_TICKS = 32
"""Number of ticks in each part of a block in which the limits of a parked vehicle are tested."""
PARKED_SAMPLE_STD = 0.05
PARKED_GRAVITY = 0.1
"""Limits of a parked vehicle for the attitude, with the samples of one second.

The first limit is the standard deviation of the force, all axes together [m/s^2]. The second limit
is the difference between the magnitude of the mean force and gravity [m/s^2].
"""
IDLE_FORCE = 0.25
IDLE_RATE = 0.05
"""Largest deviation of single ticks from their mean at a speed of zero, for force [m/s^2] and rate
[rad/s]. The causes are a running engine and people who get in.
"""
TIMES_NOISE = 4.0
"""Alternative limit of the force, as a multiple of its noise from tick to tick. With this limit, a
noisy sensor can also be at rest (4 standard deviations: 1 of 16,000 normal samples).
"""

# Whether a mean rate at rest is an error of the gyroscope ------------------------------------

MAX_GYRO_BIAS = 0.1
"""Largest gyroscope bias in the joint estimator [rad/s]: 5.7 deg/s.

If the mean rate is larger, the vehicle itself turns: the speed is stuck at zero. Zero-rate offsets
of consumer gyroscopes are some deg/s (BMI160: 3 deg/s).
"""
MAX_ZERO_OFFSET = math.radians(5.0)
"""Largest gyroscope offset in method A [rad/s]. Method A takes the mean tick by tick. A larger mean
comes from a turntable or a ferry and is not an offset.
"""
MAX_TERMINAL_BIAS = math.radians(1.5)
"""Largest gyroscope bias of a carried terminal [rad/s].

A terminal has no speed signal that shows rest, so a larger mean is a slow turn.
"""
TERMINAL_RATE_RANGE = math.radians(2.0)
"""Largest range (max - min) of any axis of a terminal's gyroscope within a second at rest
[rad/s]."""


def is_parked(force: Array, rate: Array | None) -> Flags:
    """Return flags of the ticks (N, 3) at which force [m/s^2] and rate [rad/s] are as still as in a
    parked vehicle. No speed is needed.

    N: a multiple of `STEADY_TICKS`.
    """
    move = np.abs(np.diff(force, axis=0, prepend=force[:1])).max(axis=1)
    still: Flags = move < PARKED_FORCE_CHANGE
    still &= keeps_steady(force, PARKED_FORCE_STD, STEADY_TICKS)
    if rate is not None:
        still &= keeps_steady(rate, PARKED_RATE_STD, STEADY_TICKS)
    return still


def feels_parked(variance: float, size: float) -> bool:
    """Return whether the force over a second is as still as in a parked vehicle.

    variance: sum over all axes [(m/s^2)^2]. size: magnitude of the mean force [m/s^2].
    """
    return variance < PARKED_SAMPLE_STD**2 and abs(size - GRAVITY) < PARKED_GRAVITY


def is_terminal_at_rest(spread: float, mean: Vector) -> bool:
    """Return whether the rates over a second are those of a terminal at rest.

    spread: largest range of any axis [rad/s]. mean: mean rate (3,) [rad/s].
    """
    return spread < TERMINAL_RATE_RANGE and max(map(abs, mean)) < MAX_TERMINAL_BIAS


def keeps_steady(x: Array, limit: float, ticks: int) -> Flags:
    """Return flags: whether the standard deviation of signals (N, axes) is below a limit, for parts
    of this many ticks.
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
