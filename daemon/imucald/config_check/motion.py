"""Compute means of samples on a common time grid, and the vehicle's motion from them, for `imucald
check`."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from imucald.config.vehicle import VehicleSettings
from imucald.core.arrays import Array, Flags
from imucald.core.samples import HEADING, Samples, width_of
from imucald.motion.standstill import DRIVING_SPEED, ZERO_SPEED_SMOOTHED
from imucald.motion.ticks import TICK_RATE

MAX_TICKS = 72_000
"""Largest number of ticks (two hours). The limit bounds the memory; two hours are enough to find a
wrong sign."""
MAX_HOLE = 25
"""Longest gap between samples that is interpolated [ticks of 0.1 s].

A speed over OBD-II has one sample per second."""
SMOOTH = 11
"""Length of the moving mean [ticks of 0.1 s], 1.1 s. The mean reduces the effect of delays and road
bumps."""
DRIVEN_TICKS = 600
"""Driving time after which every correct signal of a vehicle has changed [ticks of 0.1 s]: a
minute.
"""
MOVING = 3.0
"""Smallest speed for the comparison of turns [m/s]. A slower vehicle may be reversing, and with an
unsigned speed, left and right are then exchanged. A smaller speed would also be a division by
nearly zero in the curvature."""
MIN_TICKS = 200
"""Smallest number of ticks in motion for a finding about motion: 20 s."""
LARGEST_RATE = 1.0
"""Largest yaw rate from a course [rad/s]. A faster change is a jump of a receiver that begins to
move."""
MIN_STANDING_TICKS = 20
"""Smallest standing time that is used to measure zero errors (after smoothing) [ticks of 0.1 s]:
two seconds."""


class TickMeans:
    """The mean of each channel in each tick (0.1 s), collected from chunks of samples."""

    def __init__(self) -> None:
        self._sums: dict[str, Array] = {}
        self._counts: dict[str, Array] = {}
        self._heading: float | None = None
        """The last heading [rad], continued over full turns."""

    def add_samples(self, samples: Samples) -> None:
        """Add samples by channel; times are stream times."""
        for channel, series in samples.items():
            ticks = np.floor(series.t * TICK_RATE).astype(np.int64)
            inside = ticks < MAX_TICKS
            if not inside.any():
                continue
            ticks = ticks[inside]
            values = series.values[inside].reshape(len(ticks), -1)
            if channel == HEADING.channel:
                values = self._continued(values)
            self._grow(channel, values.shape[1], int(ticks[-1]) + 1)
            np.add.at(self._sums[channel], ticks, values)
            np.add.at(self._counts[channel], ticks, 1.0)

    def _continued(self, heading: Array) -> Array:
        """Return headings (n, 1) [rad] without jumps by a full turn, also across chunks."""
        before = heading[:1] if self._heading is None else np.array([[self._heading]])
        result = np.unwrap(np.concatenate([before, heading]), axis=0)[1:]
        self._heading = float(result[-1, 0])
        return np.asarray(result)

    def _grow(self, channel: str, width: int, ticks: int) -> None:
        have = self._counts.get(channel, np.zeros(0))
        if ticks <= len(have):
            return
        size = min(max(2 * len(have), ticks), MAX_TICKS)
        sums, counts = np.zeros((size, width)), np.zeros(size)
        counts[: len(have)] = have
        if channel in self._sums:
            sums[: len(have)] = self._sums[channel]
        self._sums[channel], self._counts[channel] = sums, counts

    def paces(self) -> dict[str, float]:
        """Usual time between two ticks with samples, by channel [s]."""
        gaps = {name: np.diff(np.flatnonzero(counts)) for name, counts in self._counts.items()}
        return {name: float(np.median(g)) / TICK_RATE for name, g in gaps.items() if len(g)}

    def grid(self) -> dict[str, Array]:
        """Return the means (n,) or (n, width) in all ticks, by channel. Values in short gaps are
        interpolated; other unknown values are NaN."""
        last = [np.flatnonzero(counts) for counts in self._counts.values()]
        n = max((int(rows[-1]) + 1 for rows in last if len(rows)), default=0)
        grid = {}
        for channel, sums in self._sums.items():
            counts = np.zeros(n)
            counts[: len(self._counts[channel])] = self._counts[channel][:n]
            rows = np.flatnonzero(counts)
            means = sums[rows] / counts[rows, None]
            table = np.column_stack([bridged(n, rows, column) for column in means.T])
            grid[channel] = table[:, 0] if width_of(channel) == 1 else table
        return grid


def bridged(n: int, rows: NDArray[np.intp], values: Array) -> Array:
    """Return values (n,) from `values`, which are known at `rows`. Values in short gaps are
    interpolated; values in long gaps are NaN."""
    here = np.arange(n)
    result = np.interp(here, rows, values)
    after = np.searchsorted(rows, here)
    left = rows[np.maximum(after - 1, 0)]
    right = rows[np.minimum(after, len(rows) - 1)]
    known = np.isin(here, rows) | (
        (right - left <= MAX_HOLE) & (here >= rows[0]) & (here <= rows[-1])
    )
    return np.where(known, result, np.nan)


def smooth(x: Array) -> Array:
    """Moving mean along the first axis; NaN at the ends and near NaN."""
    if x.ndim == 2:
        return np.column_stack([smooth(column) for column in x.T])
    if len(x) < SMOOTH:
        return np.full(len(x), np.nan)
    result = np.convolve(x, np.full(SMOOTH, 1.0 / SMOOTH), "same")
    half = SMOOTH // 2
    result[:half] = result[-half:] = np.nan
    return result


class Motion:
    """The vehicle's motion, computed from the time grid. An attribute is None if its signals are
    missing.

    All arrays are smoothed. speed: (n,) [m/s], negative in reverse. change: (n,) derivative of the
    speed [m/s^2]. accel: (n, 3) [m/s^2]. up, forward: (3,) unit vectors in sensor axes.
    """

    def __init__(
        self, grid: Mapping[str, Array], planar: bool, forward: Array | None = None
    ) -> None:
        """forward: direction forward (3,) in sensor axes, if it is known (see `response`)."""
        self.planar = planar
        self.grid = grid
        self.forward = forward
        self.speed = self.change = None
        if "speed" in grid:
            self.speed = smooth(self._direction() * grid["speed"])
            self.change = change_of(self.speed)
        self.accel = smooth(grid["accel"]) if "accel" in grid else None
        self.standing = None if self.speed is None else standing_at(self.speed)
        self.gravity = self._gravity()

    def scaled(self, accel: float = 1.0, speed: float = 1.0) -> Motion:
        """Return the motion with accelerometer and speed multiplied by a factor."""
        factors = {"accel": accel, "speed": speed}
        grid = {name: values * factors.get(name, 1.0) for name, values in self.grid.items()}
        return Motion(grid, self.planar, self.forward)

    def turned(self, channel: str, matrix: Array) -> Motion:
        """Return the motion with the axes of one channel multiplied by a matrix (w, w)."""
        values = self.grid[channel]
        table = values.reshape(len(values), -1) @ matrix.T
        forward = self.forward
        if channel == "accel" and forward is not None:
            forward = matrix @ forward
        grid = {**self.grid, channel: table.reshape(values.shape)}
        return Motion(grid, self.planar, forward)

    def without(self, channel: str) -> Motion:
        """Return the motion without one channel."""
        grid = {name: values for name, values in self.grid.items() if name != channel}
        return Motion(grid, self.planar, self.forward)

    def with_channel(self, channel: str, values: Array) -> Motion:
        """Return the motion with one more channel, or with other values of a channel."""
        return Motion({**self.grid, channel: values}, self.planar, self.forward)

    def facing(self, forward: Array, delay: int) -> Motion:
        """Return the motion with the direction forward (3,) in sensor axes, and with the speed
        without its delay [ticks of 0.1 s]."""
        grid = {**self.grid, "speed": shifted(self.grid["speed"], delay)}
        return Motion(grid, self.planar, forward)

    @property
    def up(self) -> Array | None:
        """The direction up (reaction to gravity) in sensor axes, unit vector (3,)."""
        if self.gravity is None:
            return None
        return np.asarray(self.gravity / np.linalg.norm(self.gravity))

    @property
    def along(self) -> Array | None:
        """Acceleration forward (n,) from the accelerometer; None if the direction is unknown."""
        if self.accel is None:
            return None
        if self.planar:
            return np.asarray(self.accel[:, 0])
        return None if self.forward is None else np.asarray(self.accel @ self.forward)

    @property
    def lateral(self) -> Array | None:
        """Acceleration to the left (n,) from the accelerometer, if its axes are right-handed; None
        if the directions are unknown."""
        if self.accel is None or self.up is None or self.forward is None:
            return None
        return np.asarray(self.accel @ np.cross(self.up, self.forward))

    @property
    def moving(self) -> Array | None:
        """The speed (n,) [m/s]; NaN where it is not above `MOVING`."""
        return None if self.speed is None else moving(self.speed)

    @cached_property
    def turn(self) -> Array | None:
        """Yaw rate (n,) [rad/s], positive to the left, from gyroscope or yaw rate signal."""
        if "gyro" in self.grid and self.up is not None and not self.planar:
            return rate_about(self.up, smooth(self.grid["gyro"]), self.standing)
        return smooth(self.grid["yaw_rate"]) if "yaw_rate" in self.grid else None

    @property
    def curvature(self) -> Array | None:
        """Curvature (n,) [1/m]: yaw rate divided by speed, NaN below `MOVING`."""
        turn, v = self.turn, self.moving
        return None if turn is None or v is None else turn / v

    @property
    def turn_zero(self) -> Array:
        """Columns (n, k) of a fit for the effect of the gyroscope's zero error on speed times turn
        rate. If the drive has a standstill, the zero error is measured there and k is 0. Otherwise
        the only column is the speed.
        """
        if self.speed is None:
            return np.zeros((0, 0))
        return self.speed[:, None] if self.standing is None else np.zeros((len(self.speed), 0))

    @property
    def drives(self) -> bool:
        """True if the vehicle drives for at least a minute, according to its speed."""
        if self.speed is None:
            return False
        return int(np.count_nonzero(np.abs(self.speed) > DRIVING_SPEED)) >= DRIVEN_TICKS

    def _direction(self) -> Array:
        """Driving direction: -1 in reverse, else 1. Shape (n,), or (1,) if reverse is unknown."""
        return np.where(np.nan_to_num(self.grid.get("reverse", np.zeros(1))) > 0.5, -1.0, 1.0)

    def _gravity(self) -> Array | None:
        """Mean specific force at rest (3,) [m/s^2]; mean of the whole drive if there is no rest."""
        if self.accel is None:
            return None
        known = np.isfinite(self.accel).all(axis=1)
        rows = known if self.standing is None else known & self.standing
        if not rows.any():
            rows = known
        if not rows.any():
            return None
        mean = np.asarray(self.accel[rows].mean(axis=0))
        return mean if np.linalg.norm(mean) > 0.0 else None

    def turn_rates(self, vehicle: VehicleSettings) -> dict[str, Array]:
        """Return each measurement of the yaw rate (n,) [rad/s], positive to the left, by quantity.

        For the gyroscope, the yaw rate is the rate about the vertical minus its mean at rest.
        """
        found: dict[str, Array] = {}
        grid = self.grid
        if "gyro" in grid and self.up is not None and not self.planar:
            found["gyroscope"] = rate_about(self.up, smooth(grid["gyro"]), self.standing)
        if "yaw_rate" in grid:
            found["yaw_rate"] = smooth(grid["yaw_rate"])
        if "wheel_speeds" in grid:
            wheels = grid["wheel_speeds"]
            difference = right_less_left(*wheels.T)
            if not np.nanmin(wheels, initial=0.0) < 0.0:  # magnitudes, as usual in vehicles
                difference = difference * self._direction()
            found["wheel_speeds"] = smooth(difference) / vehicle.track
        if self.speed is None:
            return found
        if "steering" in grid:
            angle = smooth(grid["steering"]) / vehicle.steering_ratio
            found["steering_wheel_angle"] = self.speed * angle / vehicle.wheelbase
        fast = moving(self.speed)
        if "lateral_accel" in grid:
            found["lateral_acceleration"] = smooth(grid["lateral_accel"]) / fast
        if self.planar and self.accel is not None:
            found["accelerometer.y"] = self.accel[:, 1] / fast
        if HEADING.channel in grid:  # the course of a standing vehicle is noise
            rate = course_rate(grid[HEADING.channel])
            found[HEADING.key] = np.where(np.isfinite(fast), rate, np.nan)
        return found


def less(x: Array, known: Array) -> Array:
    """Return the residual of x (n,) or (n, w) after a least-squares fit with columns (n, k) and a
    constant. The result is NaN if any input is NaN."""
    rows = np.isfinite(x).reshape(len(x), -1).all(axis=1) & np.isfinite(known).all(axis=1)
    left = np.full_like(x, np.nan)
    if rows.any():
        basis = np.column_stack([known[rows], np.ones(np.count_nonzero(rows))])
        solution, *_ = np.linalg.lstsq(basis, x[rows], rcond=None)
        left[rows] = x[rows] - basis @ solution
    return left


def shifted(x: Array, ticks: int) -> Array:
    """Return x shifted by a number of ticks: row k of the result is row k + ticks of x, or NaN if x
    has no such row."""
    result = np.full_like(x, np.nan)
    if abs(ticks) >= len(x):
        return result
    if ticks >= 0:
        result[: len(x) - ticks] = x[ticks:]
    else:
        result[-ticks:] = x[:ticks]
    return result


def change_of(x: Array) -> Array:
    """Return the derivative [1/s] of a smoothed signal (n,), from differences over the length of
    the smoothing window."""
    half = SMOOTH // 2
    return (shifted(x, half) - shifted(x, -half)) * (TICK_RATE / (2 * half))


def standing_at(speed: Array) -> Flags | None:
    """Return a mask (n,) of the ticks at rest from a smoothed speed [m/s]; None if they are too
    few."""
    calm = np.nan_to_num(np.abs(speed), nan=np.inf) < ZERO_SPEED_SMOOTHED
    return calm if np.count_nonzero(calm) >= MIN_STANDING_TICKS else None


def rate_about(up: Array, rate: Array, standing: Flags | None) -> Array:
    """Return the rate (n,) about the vertical, minus its mean at rest. up: (3,) unit vector. rate:
    (n, 3), smoothed, in the same axes."""
    about = rate @ up
    if standing is not None and np.isfinite(about[standing]).any():
        about = about - np.nanmean(about[standing])
    return np.asarray(about)


def moving(speed: Array) -> Array:
    """Return a speed (n,) [m/s]; NaN where it is not above `MOVING`."""
    return np.where(np.abs(speed) > MOVING, speed, np.nan)


def speed_ratio(speed: Array, other: Array) -> float | None:
    """Return the median ratio of two speeds (n,) [m/s] where both exceed 1 m/s; None if that is too
    seldom. The delay of one of them changes the median little."""
    speed, other = np.abs(speed), np.abs(other)
    fast = np.nan_to_num(np.minimum(speed, other)) > 1.0
    if np.count_nonzero(fast) < MIN_TICKS:
        return None
    return float(np.median(speed[fast] / other[fast]))


def right_less_left(fl: Array, fr: Array, rl: Array, rr: Array) -> Array:
    """Return how much faster the right wheels are than the left wheels (n,), from the speeds (n,)
    of the four wheels in one unit."""
    return 0.5 * (fr - fl + rr - rl)


def course_rate(course: Array) -> Array:
    """Return the yaw rate (n,) [rad/s], positive to the left, from a course (n,) [rad] that is
    clockwise and has no jumps by a full turn. NaN where the course changes faster than
    `LARGEST_RATE`.

    The difference over a second is the mean rate of that second, so the course is not smoothed
    before.
    """
    rate = -change_of(course)
    return np.where(np.abs(rate) <= LARGEST_RATE, rate, np.nan)
