"""Signals on an even time grid, for many blocks of ticks without holes at once.

In live operation, each block is computed when it is complete. In replay, all blocks of a chunk are
computed together. Live operation and replay use `even_blocks`, so the results are equal to the last
bit. A block that has a hole is marked. `signal_blocks` processes such blocks one by one.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct

from imucald.core.arrays import Array, Flags
from imucald.motion import ticks as tk
from imucald.motion.coarse_speed import (
    COARSE,
    passages,
    stays,
    step_of,
)
from imucald.motion.standstill import ROLLING_SPEED, ZERO_SPEED
from imucald.motion.ticks import TICK_S

BLOCK_TICKS = 64
"""Ticks of a block: 6.4 s. Data are examined once per block, so this length determines the
computing time."""
LAG = 16
"""Number of ticks by which the processing is behind the data: a speed of 1 Hz with jitter must have
arrived."""
BEFORE = 24
"""Ticks of context in front of a block."""
KEEP = BEFORE + LAG
ROWS = KEEP + BLOCK_TICKS
"""Number of ticks from which a block is computed."""
ACCEL_GAP = 0.35
"""Longest hole in accelerometer or gyroscope data that is bridged [s]: one lost sample at 5 Hz."""
SPEED_GAP = 2.3
"""Longest hole in the speed that is bridged [s]: one lost sample at 1 Hz."""
PART = slice(BEFORE - 1, BEFORE + BLOCK_TICKS + 1)
"""The block's own ticks within `ROWS`, with one more tick at both ends for dv/dt."""
MID = slice(1, BLOCK_TICKS + 1)
"""The block's own ticks within `PART`."""
_BACK = (np.arange(ROWS) - (ROWS - 1)) * TICK_S


class Knots(Struct, frozen=True):
    """Times (K,) at which a speed is known [s], and the step of the speed [m/s].

    times: None if the speed is known in each tick. step: 0 if no step was seen.
    """

    times: Array | None = None
    step: float = 0.0


IN_EACH_TICK = Knots()


class Driven(Struct, frozen=True):
    """Speed of a block in which every tick has a speed.

    speed: (N + 2,) [m/s]. ok: (N + 2,) True where the speed is known, see `PART`. accel: (N,) dv/dt
    [m/s^2]. least: smallest speed whose neighbouring speeds are not zero [m/s]. rolls: every speed,
    known or bridged, is above `ROLLING_SPEED`. moves: a speed is known, and no known speed is below
    `ZERO_SPEED`; the vehicle may creep. knots: times at which the speed is known.
    """

    speed: Array
    ok: Flags
    accel: Array
    least: float
    rolls: bool
    moves: bool
    knots: Knots


class EvenBlock(Struct, frozen=True):
    """Block in which every tick has a force and a rate, N = BLOCK_TICKS.

    force, rate: (N + 2, 3). ok_force, ok_rate: (N + 2,) True where force and rate are known.
    rate_seldom: some ticks have a single gyroscope sample. steering, yaw_rate, lateral: (N + 2,);
    None unless all ticks have the signal. has_heading, has_reverse: True if any tick has a heading
    or a reverse signal. is_reverse: True if any tick is in reverse.
    """

    force: Array
    ok_force: Flags
    rate: Array
    ok_rate: Flags
    rate_seldom: bool
    driven: Driven | None
    steering: Array | None
    yaw_rate: Array | None
    lateral: Array | None
    has_heading: bool
    has_reverse: bool
    is_reverse: bool


def bridged_blocks(at: Array, times: Array, values: Array, longest: float) -> tuple[Array, Flags]:
    """Interpolate samples (B, M) or (B, M, w) at times (B, N). The second result is False for a
    time in a hole longer than `longest` [s].

    at: middles of the ticks [s].
    """
    m = times.shape[1]
    after = np.array([one.searchsorted(x) for one, x in zip(times, at, strict=True)])
    low, high = np.maximum(after - 1, 0), np.minimum(after, m - 1)
    of = np.arange(len(at))[:, None]
    right, left = times[of, high], times[of, low]
    width = right - left
    # A tick that a hole cuts has samples of its own, whose mean is not at its middle.
    own = np.minimum(np.abs(at - left), np.abs(right - at)) <= 0.5 * TICK_S
    ok = (width <= longest) | own
    ends = (after == 0) | (after == m)  # before the first sample, or after the last
    if ends.any():
        ok[ends] = np.abs(at - left)[ends] <= 0.3 * longest
    if values.ndim == 2:
        return np.array([np.interp(*of_one) for of_one in zip(at, times, values, strict=True)]), ok
    width[width <= 0.0] = math.inf
    part = (at - left) / width
    before = values[of, low]
    out: Array = before + part[..., None] * (values[of, high] - before)
    return out, ok


def bridged(at: Array, times: Array, values: Array, longest: float) -> tuple[Array, Flags]:
    """Interpolate samples (M,) or (M, w) at times (N,). The second result is False for a time in a
    hole longer than `longest` [s]."""
    if len(times) < 1:
        return np.zeros((len(at), *values.shape[1:])), np.zeros(len(at), dtype=bool)
    out, ok = bridged_blocks(at[None], times[None], values[None], longest)
    return out[0], ok[0]


def speed_blocks(at: Array, times: Array, values: Array) -> tuple[Array, Flags, list[Knots]]:
    """Interpolate speeds (B, M) as `bridged_blocks` does. The speeds may be coarse.

    Also returns the times at which each speed is known.
    """
    out, ok = bridged_blocks(at, times, values, SPEED_GAP)
    knots = [IN_EACH_TICK] * len(at)
    for b in np.flatnonzero(stays(values)).tolist():
        if (step := step_of(values[b])) >= COARSE:
            when, speeds = passages(times[b], values[b], step)
            out[b], knots[b] = (
                np.interp(at[b], when, speeds),
                Knots(when, step),
            )
    return out, ok, knots


def bridged_speed(
    at: Array, times: Array, values: Array, step: float = 0.0
) -> tuple[Array, Flags, Knots]:
    """Interpolate speeds (M,) as `bridged` does. The speeds may be coarse.

    Also returns the times at which the speed is known. step: step of the speeds if they are known
    to be coarse [m/s].
    """
    if len(times) < 1:
        return *bridged(at, times, values, SPEED_GAP), IN_EACH_TICK
    if step:
        when, speeds = passages(times, values, step)
        _, ok = bridged(at, times, values, SPEED_GAP)
        return np.interp(at, when, speeds), ok, Knots(when, step)
    out, ok, (knots,) = speed_blocks(at[None], times[None], values[None])
    return out[0], ok[0], Knots(times) if knots.times is None else knots


def times_of(end: Array) -> Array:
    """Return the ends of the ticks (..., ROWS) of blocks [s]. end: (..., 1) end of the last tick of
    each block [s].
    """
    return np.asarray(end + _BACK)


def even_blocks(rows: Array) -> list[EvenBlock | None]:
    """Return the blocks of ticks (KEEP + B * BLOCK_TICKS, COLUMNS); None for a block whose force or
    rate has a hole.

    The caller must have removed impossible numbers, see `SignalHealth.drop_impossible`.
    """
    windows = np.lib.stride_tricks.sliding_window_view(rows, ROWS, axis=0)[::BLOCK_TICKS]
    windows = windows.transpose(0, 2, 1)
    whole = _whole(windows, tk.ACCEL.n) & _whole(windows, tk.GYRO.n)
    found: list[EvenBlock | None] = [None] * len(windows)
    if not whole.any():
        return found
    if not whole.all():
        windows = windows[whole]
    t = times_of(windows[:, -1:, tk.T])
    at = t[:, PART] - 0.5 * TICK_S
    force, ok_force, _ = _sensed(windows, t, at, tk.ACCEL)
    rate, ok_rate, rate_seldom = _sensed(windows, t, at, tk.GYRO)
    driven = _driven(windows, t, at)
    columns = tk.STEERING, tk.YAW_RATE, tk.LATERAL_ACCEL
    steering, yaw_rate, lateral = (_means(windows, of) for of in columns)
    heading, reverse = windows[:, :, tk.HEADING], windows[:, :, tk.REVERSE]
    has_heading, has_reverse = (np.any(~np.isnan(x), axis=1).tolist() for x in (heading, reverse))
    is_reverse = np.any(reverse > 0.5, axis=1).tolist()
    for i, b in enumerate(np.flatnonzero(whole).tolist()):
        found[b] = EvenBlock(
            force=force[i],
            ok_force=ok_force[i],
            rate=rate[i],
            ok_rate=ok_rate[i],
            rate_seldom=rate_seldom[i],
            driven=driven[i],
            steering=steering[i],
            yaw_rate=yaw_rate[i],
            lateral=lateral[i],
            has_heading=has_heading[i],
            has_reverse=has_reverse[i],
            is_reverse=is_reverse[i],
        )
    return found


def _whole(windows: Array, count: int) -> Flags:
    """Return flags (B,) of the blocks in which all ticks have samples."""
    return np.asarray((windows[:, :, count] > 0).all(axis=1))


def _sensed(
    windows: Array, t: Array, at: Array, columns: tk.AccelColumns | tk.GyroColumns
) -> tuple[Array, Flags, list[bool]]:
    """Return values (B, N + 2, 3), flags of the known values, and for each block whether samples
    are seldom.
    """
    times = t - windows[:, :, columns.age]
    mean = windows[:, :, columns.x : columns.z + 1]
    seldom = windows[:, :, columns.n] < 2
    values, ok = bridged_blocks(at, times, mean, ACCEL_GAP)
    return values, ok, np.any(seldom, axis=1).tolist()


def _means(windows: Array, columns: tk.SignalColumns) -> list[Array | None]:
    """Return the mean of each tick as the value at the middle of the tick, without
    interpolation."""
    whole, values = _whole(windows, columns.n).tolist(), windows[:, PART, columns.mean]
    return [values[b].copy() if has else None for b, has in enumerate(whole)]


def _driven(windows: Array, t: Array, at: Array) -> list[Driven | None]:
    """Return the speed of the blocks."""
    whole = _whole(windows, tk.SPEED.n)
    found: list[Driven | None] = [None] * len(windows)
    if not whole.any():
        return found
    if not whole.all():
        windows, t, at = windows[whole], t[whole], at[whole]
    mean = windows[:, :, tk.SPEED.mean]
    speed, ok, knots = speed_blocks(at, t - windows[:, :, tk.SPEED.age], mean)
    size = np.abs(mean)
    moves: Flags = size > ZERO_SPEED
    between = moves[:, 1:-1] & moves[:, :-2] & moves[:, 2:]
    least = np.where(between, size[:, 1:-1], math.inf).min(axis=1).tolist()
    accel = (speed[:, 2:] - speed[:, :-2]) / (2.0 * TICK_S)
    bridged_size = np.abs(speed)
    rolls = [least > ROLLING_SPEED for least in bridged_size.min(axis=1).tolist()]
    ok_mid = ok[:, MID]
    rests = np.any(ok_mid & (bridged_size[:, MID] < ZERO_SPEED), axis=1)
    is_moving = (np.any(ok_mid, axis=1) & ~rests).tolist()
    for i, b in enumerate(np.flatnonzero(whole).tolist()):
        found[b] = Driven(speed[i], ok[i], accel[i], least[i], rolls[i], is_moving[i], knots[i])
    return found
