"""One measured drive on a uniform grid: every signal through the same low-pass.

Signals come at their own rates and times. They are interpolated to a fine grid, low-passed by one
filter and thinned to `GRID_HZ`, so that nothing but their own delays and bandwidths sets them
apart. Where a signal was absent, stuck or out of its range, rows are marked as not valid.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.signal import firwin, upfirdn

from imucald.core.errors import EstimateError
from imucald.core.samples import Samples, Series

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

GRID_HZ = 10.0
"""Vehicle motion and the suspension's first modes lie below 4 Hz."""
FINE_HZ = 100.0
PASS_HZ = 4.0
"""Cut-off of the common low-pass."""
TAPS = 61
"""Length of that filter on the fine grid: 0.6 s."""
GAP_PERIODS = 3.5
"""A signal is absent where samples are further apart than this many of its usual periods."""
SHORTEST_GAP_S = 0.15
BAND_SHARE = 0.35
"""A signal sampled at some rate carries motion up to this share of it."""
TOP_HZ = 1.8
"""Nothing is compared above this frequency."""
SPOILT_REACH_S = 1.0
"""What is derived of a wrong value is wrong for so long around it."""
STANDING_MPS = 0.05
ROLLING_MPS = 1.2
"""Between standing and rolling, speed signals have dead bands: such rows are not used."""
SETTLE_S = 1.0
"""After coming to rest the body still rocks on its springs."""

CHANNELS = ("speed", "steering", "yaw_rate", "lateral_accel", "longitudinal_accel", "temperature")


@dataclass(frozen=True)
class Track:
    """A drive on the grid; arrays have N rows at `GRID_HZ`, SI units.

    accel, gyro: (3, N) in sensor axes, or None; likewise the scalar signals (N,).
    """

    t: Array
    accel: Array
    gyro: Array | None
    scalars: Mapping[str, Array]
    """Signals of `CHANNELS` that the drive has; speed is signed."""
    usable: Mapping[str, Mask]
    """For each signal, rows where it was there and believed."""
    standing: Mask
    top_hz: float
    """Highest frequency at which every input still carries motion."""
    planar: bool
    """The accelerometer has no vertical axis."""
    level: Mapping[str, Array]
    """(N,) rms of the change from sample to sample, per sensor: vibration, if that is quick."""
    rates_hz: Mapping[str, float]
    """Samples a second, per sensor."""

    @property
    def duration_s(self) -> float:
        """Length [s]."""
        return len(self.t) / GRID_HZ


def track_from_samples(
    samples: Samples, spoilt: Mapping[str, tuple[tuple[float, float], ...]] | None = None
) -> Track:
    """Put a drive on the grid.

    samples: needs `accel` and `speed`. spoilt: stretches [s] of a signal that must not be used
    (stuck, saturated). Raises EstimateError where what is needed is not there.
    """
    for name in ("accel", "speed"):
        if name not in samples or len(samples[name].t) < 100:
            raise EstimateError(f"diagnosis needs the signal {name!r}, and minutes of it")
    start = max(samples["accel"].t[0], samples["speed"].t[0])
    stop = min(samples["accel"].t[-1], samples["speed"].t[-1])
    n = int((stop - start) * GRID_HZ)
    if n < 600:
        raise EstimateError("diagnosis needs at least a minute in which all signals are there")
    t = start + np.arange(n) / GRID_HZ
    names = [name for name in ("accel", "gyro", *CHANNELS) if name in samples]
    names = [name for name in names if len(samples[name].t) >= 10]
    values = {name: _on_grid(samples[name], start, n) for name in names}
    bad = dict(spoilt or {})
    usable = {name: _present(samples[name], t, bad.get(name, ())) for name in names}
    level: dict[str, Array] = {
        name: _vibration(samples[name], start, n) for name in names if name in ("accel", "gyro")
    }
    speed = np.maximum(values["speed"], 0.0)
    if "reverse" in samples and len(samples["reverse"].t):
        speed = np.where(_last(samples["reverse"], t) > 0.5, -speed, speed)
    scalars = {name: values[name] for name in CHANNELS if name in values}
    scalars["speed"] = speed
    standing, moving = _standing(speed)
    known = standing | moving
    usable = {name: x if name == "temperature" else x & known for name, x in usable.items()}
    rates = [_rate(samples[name]) for name in ("accel", "gyro", "speed", "yaw_rate")
             if name in names]  # fmt: skip
    return Track(
        t=t,
        accel=values["accel"],
        gyro=values.get("gyro"),
        scalars=scalars,
        usable=usable,
        standing=standing,
        top_hz=min(TOP_HZ, BAND_SHARE * min(rates)),
        planar=bool(np.ptp(samples["accel"].values[:, 2]) == 0.0),
        level=level,
        rates_hz={name: _rate(samples[name]) for name in level},
    )


def _rate(series: Series) -> float:
    period = float(np.median(np.diff(series.t[:20000])))
    return 1.0 / max(period, 1e-4)


def _on_grid(series: Series, start: float, n: int) -> Array:
    """Interpolate, low-pass, thin: (N,) or (3, N)."""
    pad = TAPS
    step = round(FINE_HZ / GRID_HZ)
    fine = start + (np.arange(n * step + 2 * pad) - pad) / FINE_HZ
    columns = series.values.reshape(len(series.t), -1).T
    taps = firwin(TAPS, PASS_HZ, fs=FINE_HZ, window=("kaiser", 5.0))
    half = TAPS // 2
    made = []
    for column in columns:
        x = _interpolated(series.t, column, fine)
        low = upfirdn(taps, x[pad - half :], down=step)
        first = (TAPS - 1) // step
        made.append(low[first : first + n])
    return np.array(made) if series.values.ndim > 1 else made[0]


def _interpolated(t: Array, x: Array, fine: Array) -> Array:
    """Slow signals by a monotone cubic, fast ones linearly."""
    if len(t) > 3 and np.median(np.diff(t[:2000])) > 0.04:
        keep = np.concatenate(([True], np.diff(t) > 0.0))
        inside = np.clip(fine, t[0], t[-1])
        result: Array = PchipInterpolator(t[keep], x[keep])(inside)
        return result
    return np.interp(fine, t, x)


def _present(series: Series, t: Array, bad: tuple[tuple[float, float], ...]) -> Mask:
    """Rows whose filter reached no gap and no bad stretch."""
    reach = 0.5 * TAPS / FINE_HZ
    here = np.ones(len(t), dtype=bool)
    steps = np.diff(series.t)
    limit = max(GAP_PERIODS * float(np.median(steps)), SHORTEST_GAP_S)
    gaps = [(series.t[i], series.t[i + 1]) for i in np.flatnonzero(steps > limit)]
    gaps += [(-np.inf, series.t[0]), (series.t[-1], np.inf)]
    gaps += [(first - SPOILT_REACH_S, last + SPOILT_REACH_S) for first, last in bad]
    for first, last in gaps:
        low, high = np.searchsorted(t, [first - reach, last + reach])
        here[low:high] = False
    return here


def _last(series: Series, t: Array) -> Array:
    index = np.clip(np.searchsorted(series.t, t, side="right") - 1, 0, len(series.t) - 1)
    return series.values[index]


def _standing(speed: Array) -> tuple[Mask, Mask]:
    """Rows at rest (settled), and rows rolling, with the filter's reach kept off."""
    margin = round(0.5 * GRID_HZ)
    zero = np.abs(speed) < STANDING_MPS
    settle = round(SETTLE_S * GRID_HZ)
    standing = _eroded(zero, settle, margin)
    rolling = _eroded(np.abs(speed) > ROLLING_MPS, margin, margin)
    return standing, rolling


def _eroded(mask: Mask, before: int, after: int) -> Mask:
    """Keep rows with the mask set for `before` rows up to them and `after` rows from them."""
    n = len(mask)
    off = np.concatenate(([0], np.cumsum(~mask)))
    low = np.maximum(np.arange(n) - before, 0)
    high = np.minimum(np.arange(n) + after + 1, n)
    return np.asarray(off[high] == off[low])


def _vibration(series: Series, start: float, n: int) -> Array:
    """Root of the mean square of sample-to-sample changes around each row, over all axes."""
    change = np.sum(np.diff(series.values, axis=0) ** 2, axis=1)
    index = np.floor((series.t[1:] - start) * GRID_HZ).astype(np.int64)
    inside = (index >= 0) & (index < n)
    total = np.bincount(index[inside], change[inside], minlength=n)
    count = np.bincount(index[inside], minlength=n)
    width = round(2.0 * GRID_HZ) + 1
    kernel = np.ones(width)
    smooth = np.convolve(total, kernel, "same") / np.maximum(np.convolve(count, kernel, "same"), 1)
    return np.asarray(np.sqrt(smooth), dtype=float)
