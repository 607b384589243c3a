"""Join the samples of accelerometer (force) and gyroscope (rate) into one series, with covariances.

The covariance of a corrected vector v has two parts. The first part is the mount error: [v]x P
[v]x', where P is the covariance of the rotation error about the vehicle's axes. The second part is
the noise of a sample: the variance of second differences divided by 6 (von Neumann and others, Ann.
Math. Stat. 12, 1941). The motion of the vehicle hardly changes second differences.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from imucald.api.columns import Columns
from imucald.core.angles import RAD_PER_DEG
from imucald.core.arrays import Array
from imucald.core.rotations import skew

_BLOCK = 10_000
"""Number of rows that are processed together. The number bounds the memory, because one part may be
a whole drive."""
_FURTHEST_S = 0.05
"""Largest time difference [s] between a force and its rate: half a period of 10 Hz."""
_UPPER = ("xx", "xy", "xz", "yy", "yz", "zz")
_SECOND_DIFFERENCE = 6.0
"""Variance of x[i-1] - 2 x[i] + x[i+1] divided by the variance of x (white noise)."""


class ImuSamples(NamedTuple):
    """Samples of accelerometer and gyroscope.

    times: (N,) [us]. force: (N, 3) [m/s^2]. rate: (N, 3) [rad/s], NaN without a gyroscope.
    force_covariance, rate_covariance: (N, 9), 3 x 3 matrices row by row.
    """

    times: Array
    force: Array
    rate: Array
    force_covariance: Array
    rate_covariance: Array


def mounts_of(history: Columns) -> Array:
    """Return time [s] and covariance [rad^2] of the history rows with a known mount, (N, 10)."""
    entries = [history[f"cov_{name}_deg2"] * RAD_PER_DEG**2 for name in _UPPER]
    rows = (0, 1, 2, 1, 3, 4, 2, 4, 5)  # of the full matrix, by row
    found = np.stack([history["t_s"], *(entries[i] for i in rows)], axis=1)
    return _complete(found)


def joined(force: Columns, rate: Columns | None, mounts: Array) -> Iterator[ImuSamples]:
    """Join each known force with the nearest rate.

    mounts: the result of `mounts_of`. Each row is valid from its time to the time of the next row.
    Before the first row, or if there is no row, the covariance contains only the noise.
    """
    forces, rates = _known(force), np.zeros((0, 5)) if rate is None else _known(rate)
    force_noise, rate_noise = _noise(forces[:, 2:]), _noise(rates[:, 2:])
    for start in range(0, len(forces), _BLOCK):
        t, times, *axes = forces[start : start + _BLOCK].T
        values, nearest = np.stack(axes, axis=1), _nearest(rates, t)
        of = np.searchsorted(mounts[:, 0], t, "right") - 1
        turns = np.zeros((len(t), 9))
        turns[of >= 0] = mounts[of[of >= 0], 1:]
        covariances = (
            _covariance(v, turns, noise)
            for v, noise in ((values, force_noise), (nearest, rate_noise))
        )
        yield ImuSamples(times.astype(np.int64), values, nearest, *covariances)


def _known(rows: Columns) -> Array:
    """Return an array (N, 5) of the rows without a missing axis: time [s], time [us], three
    values."""
    return _complete(np.stack([array.astype(float) for array in rows.arrays[:5]], axis=1))


def _complete(rows: Array) -> Array:
    found: Array = rows[~np.isnan(rows).any(axis=1)]
    return found


def _noise(values: Array) -> Array:
    """Return the variance (3,) of the noise of a sample; zeros if there are too few samples."""
    if len(values) < 3:
        return np.zeros(3)
    noise: Array = np.mean(np.diff(values, n=2, axis=0) ** 2, axis=0) / _SECOND_DIFFERENCE
    return noise


def _nearest(rates: Array, t: Array) -> Array:
    """Return for each time the nearest rate, (N, 3); NaN if no rate is close enough."""
    if not len(rates):
        return np.full((len(t), 3), np.nan)
    after = np.searchsorted(rates[:, 0], t).clip(1, max(1, len(rates) - 1))
    before = after - 1
    after = after.clip(max=len(rates) - 1)
    is_after = np.abs(rates[after, 0] - t) < np.abs(rates[before, 0] - t)
    chosen = rates[np.where(is_after, after, before)]
    found: Array = chosen[:, 2:].copy()
    found[np.abs(chosen[:, 0] - t) > _FURTHEST_S] = np.nan
    return found


def _covariance(values: Array, turns: Array, noise: Array) -> Array:
    """Return the covariances (N, 9) of vectors (N, 3). turns: covariances (N, 9) of the rotation
    error. noise: variance (3,) of the noise."""
    cross = skew(np.nan_to_num(values))
    found: Array = cross @ turns.reshape(-1, 3, 3) @ cross.transpose(0, 2, 1) + np.diag(noise)
    return found.reshape(-1, 9)
