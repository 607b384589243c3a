"""Who decides "at rest": all thresholds side by side with their reasons, and what applies them.

They differ because what is asked differs: whether the *signal* says zero, whether the *sensor*
feels nothing but an engine at idle, whether a mean rate at rest is the gyroscope's error or a turn.
How long it must last is with those who ask. The static test of method A is the published one
(`mount.method_a.static_test`); its limits are settings (`config.calibration`).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from imucald.core.arrays import Array
from imucald.core.rotations import Vector
from imucald.core.samples import GRAVITY

Flags = NDArray[np.bool_]

# What a speed signal says ------------------------------------------------------------------

ZERO_SPEED = 0.05
"""A speed below is standstill [m/s] where speeds are interpolated: finer than any bus's step, so
only zero itself passes, and rounding."""
ZERO_SPEED_SMOOTHED = 0.1
"""The same [m/s] of a speed that was averaged over its neighbours: a step of a coarse signal in
one of them is not zero, noise about zero is."""
ROLLING_SPEED = 0.5
"""Faster than this [m/s] a vehicle rolls, so that a sensor cannot say the same all the time."""
DRIVING_SPEED = 1.0
"""Slower than this [m/s] wheels may well not be seen to turn: inductive wheel sensors fall silent
at 2-4 km/h."""

# What a sensor feels -----------------------------------------------------------------------

PARKED_FORCE_CHANGE = 0.12
PARKED_FORCE_STD = 0.06
PARKED_RATE_STD = 0.01
"""Without speed only what is as still as a parked vehicle is rest: change of the mean force from
tick to tick [m/s^2], standard deviation over some seconds of force [m/s^2] and rate [rad/s]. A
smooth road at steady speed shakes a tick's mean by more, an engine at idle by less."""
STEADY_TICKS = 32
"""... over such parts of a block."""
PARKED_SAMPLE_STD = 0.05
PARKED_GRAVITY = 0.1
"""The same for the attitude, which sees samples over a second: standard deviation of the
force, all axes together, and how far the size of its mean may be from gravity [m/s^2]."""
IDLE_FORCE = 0.25
IDLE_RATE = 0.05
"""With a speed of zero, how far means of ticks stay from their mean, force [m/s^2] and rate
[rad/s]: an engine runs and people get in."""
TIMES_NOISE = 4.0
"""... or within so many times a force's noise from tick to tick: a noisy sensor rests as well
(4 standard deviations: 1 of 16,000 normal samples)."""

# Whether a mean rate at rest is an error of the gyroscope ------------------------------------

MAX_GYRO_BIAS = 0.1
"""Full estimator: 5.7 deg/s. Beyond [rad/s] the floor turns: a speed stuck at zero is no rest.
Zero-rate offsets of consumer gyroscopes are some deg/s (BMI160: 3 deg/s)."""
MAX_ZERO_OFFSET = math.radians(5.0)
"""Method A, where the mean is taken tick by tick [rad/s]: a turntable or a ferry, not an offset."""
MAX_TERMINAL_BIAS = math.radians(1.5)
"""A carried terminal has no speed to say that it rests: a larger mean is a slow turn [rad/s]."""
TERMINAL_RATE_RANGE = math.radians(2.0)
"""At rest no axis of a terminal's gyroscope moves by more within a second [rad/s]."""


def is_parked(force: Array, rate: Array | None) -> Flags:
    """Without speed: where ticks (N, 3) of force [m/s^2] and rate [rad/s] are a parked vehicle's.

    N: a multiple of `STEADY_TICKS`.
    """
    move = np.abs(np.diff(force, axis=0, prepend=force[:1])).max(axis=1)
    still: Flags = move < PARKED_FORCE_CHANGE
    still &= keeps_steady(force, PARKED_FORCE_STD, STEADY_TICKS)
    if rate is not None:
        still &= keeps_steady(rate, PARKED_RATE_STD, STEADY_TICKS)
    return still


def feels_parked(variance: float, size: float) -> bool:
    """Whether a second's force is a parked vehicle's, by its variance and the size of its mean.

    variance: of all axes together [(m/s^2)^2]; size [m/s^2].
    """
    return variance < PARKED_SAMPLE_STD**2 and abs(size - GRAVITY) < PARKED_GRAVITY


def is_terminal_at_rest(spread: float, mean: Vector) -> bool:
    """Whether a second's rates are a terminal's at rest, by the largest range and their mean."""
    return spread < TERMINAL_RATE_RANGE and max(map(abs, mean)) < MAX_TERMINAL_BIAS


def keeps_steady(x: Array, limit: float, ticks: int) -> Flags:
    """Where signals (N, axes) keep within a standard deviation, part by part of so many ticks."""
    spread = x.reshape(-1, ticks, x.shape[1]).std(axis=1).max(axis=1)
    return np.repeat(spread < limit, ticks)


def is_idle(rate: Array, force: Array) -> bool:
    """Whether rates and forces (N, 3) at a speed of zero are those of a vehicle at rest."""
    change = np.diff(force, axis=0)
    noise = np.sqrt(0.5 * (change * change).mean(axis=0))
    allowed = np.maximum(IDLE_FORCE, TIMES_NOISE * noise)
    quiet = np.abs(rate - rate.mean(axis=0)).max() < IDLE_RATE
    return bool(quiet and (np.abs(force - force.mean(axis=0)) < allowed).all())
