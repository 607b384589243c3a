"""Conditions that a sensor's error may depend on: quantities of the drive at each instant."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.signal import lfilter

from imucald.core.arrays import Array
from imucald.diagnosis.equations.forward import Forward
from imucald.diagnosis.signals import STANDING_MPS, STEP_S, Channel, Mask

SMOOTH_S = 1.0
"""Turning and braking manoeuvres last longer than this."""
CRAWL_MPS = 3.0
SHAKEN_S = (3.0, 10.0)
"""Lengths of time over which vibration is averaged, up to those that a segment's tilt absorbs."""
LARGE = (1.0, 2.0)
"""Levels, in multiples of the rms, above which a value may leave an after-effect: octaves, so one
lies within a factor of 1.4 of most true levels."""
AFTER_STOP_S = 60.0
MEMORY_S = 20.0
"""Time constant of the memory: between the length of a bend and that of a segment."""
SPEEDS = ("the speed", "crawling", "the time since standing")
EITHER_WAY = (
    "accelerating and braking", *(f"the last acceleration of {n:g} times the usual" for n in LARGE)
)  # fmt: skip
TO_ONE_SIDE = (
    "the side it turns to", *(f"the last turning of {n:g} times the usual" for n in LARGE)
)  # fmt: skip
"""Conditions that change sign when left and right are exchanged; a vehicle is symmetric to that."""
STAMPS = "the distance of its time stamps from an even cycle"
PAUSE_S = 10.0
"""After a longer gap a sender starts again at any phase of its cycle."""
ENDS = (0.05, 0.95)
BEYOND = 0.5
"""Distance to which a condition is followed beyond the two percentiles, relative to their
distance."""


def conditions(f: Forward) -> dict[str, Array]:
    """(N,) by name: scaled from -0.5 at the 5th to 0.5 at the 95th percentile of the rows in
    motion."""
    v = f.amount_of_speed()
    moves = v > STANDING_MPS
    if not moves.any():
        return {}
    made = {SPEEDS[0]: v, SPEEDS[1]: np.exp(-v / CRAWL_MPS)}
    if not moves.all():
        made[SPEEDS[2]] = np.exp(-_since(~moves) / AFTER_STOP_S)
    made |= _of(_accelerating(f), moves, "acceleration", EITHER_WAY[0])
    if f.has_turning:
        made |= _of(_smooth(f.yaw_rate()), moves, "turning", TO_ONE_SIDE[0])
    made |= {f"shaking in {x:g} s": shaken(f, x) for x in SHAKEN_S}
    made[f"shaking in {MEMORY_S:g} s"] = _remembered(shaken(f, SHAKEN_S[0]))
    stamps = f.drive.channels["speed"].t
    made[STAMPS] = np.interp(f.t, stamps, off_cycle(stamps))
    ends = {name: np.quantile(x[moves], ENDS) for name, x in made.items()}
    return {
        name: np.clip((x - low) / (high - low), -BEYOND, 1.0 + BEYOND) - 0.5
        for (name, x), (low, high) in zip(made.items(), ends.values(), strict=True)
        if high > low
    }


def _of(x: Array, moves: Mask, what: str, side: str) -> Mapping[str, Array]:
    """Direction and amount of a quantity (N,), now and in the recent past. Its scale is its rms."""
    z = x / max(float(np.sqrt(np.mean(x[moves] ** 2))), 1e-12)
    rows, amount = np.arange(len(z)), np.abs(z)
    last = {n: np.maximum.accumulate(np.where(amount > n, rows, 0)) for n in LARGE}
    return {
        side: np.tanh(z),
        **{f"the last {what} of {n:g} times the usual": np.sign(z[k]) for n, k in last.items()},
        f"the amount of {what}": amount,
        f"the amount of {what} in {MEMORY_S:g} s": _remembered(amount),
    }


def _accelerating(f: Forward) -> Array:
    """(N,) slope of the speed [m/s^2]."""
    knots: Channel = f.drive.knots
    slopes = np.diff(knots.values) / np.diff(knots.t)
    return _smooth(np.interp(f.t, 0.5 * (f.knots[1:] + f.knots[:-1]), slopes))


def _smooth(x: Array) -> Array:
    n = round(SMOOTH_S / STEP_S)
    return np.asarray(np.convolve(x, np.ones(n) / n, "same"))


def _since(stands: Mask) -> Array:
    """(N,) time since the vehicle last stood [s]; infinite before its first stop."""
    rows = np.arange(len(stands))
    last = np.maximum.accumulate(np.where(stands, rows, -1))
    return np.where(last >= 0, (rows - last) * STEP_S, np.inf)


def _remembered(x: Array) -> Array:
    """(N,) mean of the past with exponential weights, time constant `MEMORY_S`."""
    share = 1.0 - np.exp(-STEP_S / MEMORY_S)
    made, _ = lfilter([share], [1.0, share - 1.0], x, zi=[x[0] * (1.0 - share)])
    return np.asarray(made)


def shaken(f: Forward, seconds: float) -> Array:
    """(N,) mean square of the accelerometer's differences about each time, scaled so that the
    smoothest and the roughest twentieth of the drive are 1 apart."""
    accel = f.drive.channels["accel"]
    power = np.sum(np.diff(accel.values, axis=0) ** 2, axis=1)
    area = np.concatenate([[0.0], np.cumsum(power)])
    first, last = (np.searchsorted(accel.t[1:], f.t + x * seconds) for x in (-0.5, 0.5))
    mean = (area[last] - area[first]) / np.maximum(last - first, 1)
    low, high = np.quantile(mean, ENDS)
    return np.asarray((mean - low) / max(float(high - low), 1e-12))


def off_cycle(t: Array) -> Array:
    """(N,) delay of stamps against a constant cycle [s]. t: (N,) stamps [s], ascending.

    A cyclic sender gives cyclic stamps. If stamps leave the cycle, either the sender left it or the
    stamping clock is wrong; a delay that follows them shows the second. Steps are counted in whole
    cycles, so a lost frame does not delay the next one.
    """
    steps = np.diff(t)
    cycle = float(np.median(steps))
    late = steps - cycle * np.maximum(np.round(steps / cycle), 1.0)
    late[steps > PAUSE_S] = 0.0
    total = np.concatenate([[0.0], np.cumsum(late)])
    line = np.column_stack([np.ones(len(t)), t - t.mean()])
    return np.asarray(total - line @ np.linalg.lstsq(line, total, rcond=None)[0])
