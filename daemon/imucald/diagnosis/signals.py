"""Signals of one drive on a common time grid, readable with any delay, without duplicates and bad
intervals of time.

Every signal is read as its mean over one grid step around a time, so all signals have the same
low-pass filter. A delay shifts this time. The speed often comes only once a second, so it is kept
as a list of knots. Between two knots, the speed is not known.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom

from imucald.core.arrays import Array, true_runs
from imucald.core.errors import EstimateError
from imucald.core.samples import Samples, Series
from imucald.motion.ticks import TICK_S

Mask = NDArray[np.bool_]
Spans = tuple[tuple[float, float], ...]

STEP_S = TICK_S
"""Step of the grid [s]. The motion of a vehicle is below 2 Hz."""
DUPLICATE_SHARE = 0.3
"""Share of the period within which a repeated value means that the frame was sent twice."""
BESIDE = 10
"""Number of samples before and after a sample from which the local share of repeated values is
computed."""
CHANCE = 0.01
"""Chance of a false finding of one test in one drive without errors. A test of several signals,
axes or bands divides this chance among them."""
STANDING_MPS = 0.05
DRIVING_MPS = 2.0
"""Speed above which a vehicle is surely driving, whatever its speed sensor's dead band."""
FASTEST_REST_RADPS = np.radians(0.3)
"""Largest rms of a gyroscope about its mean at rest [rad/s]. An idling engine causes a smaller
rms."""
TRIM_S = 1.5
"""Time that is removed at both ends of a stop [s]. The speed signal is late, and it is zero before
the vehicle stands (dead band)."""
SHORTEST_STOP_S = 2.0
NEEDED = ("accel", "speed")
SIGNALS = (
    "accel", "gyro", "speed", "wheel_speeds", "steering", "yaw_rate", "lateral_accel",
    "longitudinal_accel",
)  # fmt: skip
"""Signals that the diagnosis compares and tests."""


@dataclass(frozen=True)
class Stop:
    """A standstill that both the speed and the inertial sensor show. The ends of the standstill are
    removed."""

    start_s: float
    stop_s: float
    gyro: Array
    """Mean rate (3,) in sensor axes [rad/s]."""
    accel: Array
    """Mean specific force (3,) in sensor axes [m/s^2]."""


@dataclass(frozen=True)
class Channel:
    """One signal that can be read with any delay. values: (N,) or (N, width)."""

    t: Array
    values: Array
    period_s: float
    bad: Spans
    _integral: Array = field(repr=False)

    @staticmethod
    def from_series(series: Series, bad: Spans = ()) -> Channel:
        """Drop unusable samples and integrate the others."""
        t, values = series.t, series.values
        period = float(np.median(np.diff(t))) if len(t) > 2 else np.inf
        kept = ~unusable(series, period)
        t, values = t[kept], values[kept]
        steps = np.diff(t).reshape(-1, *[1] * (values.ndim - 1))
        area = np.cumsum(0.5 * (values[1:] + values[:-1]) * steps, axis=0)
        return Channel(t, values, period, bad,
                       np.concatenate([np.zeros_like(values[:1]), area]))  # fmt: skip

    def means(self, t: Array, width: float = STEP_S) -> Array:
        """Return the mean over `width` around each time [s]. Beyond the ends, the end values are
        used."""
        low, high = t - 0.5 * width, t + 0.5 * width
        columns = self._integral.reshape(len(self.t), -1).T
        ends = self.values.reshape(len(self.t), -1).T
        rows = [
            (self._at(high, c, e) - self._at(low, c, e)) / width
            for c, e in zip(columns, ends, strict=True)
        ]
        return np.asarray(rows[0] if self.values.ndim == 1 else np.column_stack(rows))

    def _at(self, t: Array, integral: Array, ends: Array) -> Array:
        """Return the integral up to t. Outside the data, the end values are used. The integral is
        interpolated linearly between samples, which shifts the mean by less than one sample."""
        inside = np.interp(t, self.t, integral)
        before, after = np.minimum(t - self.t[0], 0.0), np.maximum(t - self.t[-1], 0.0)
        return np.asarray(inside + before * ends[0] + after * ends[-1])

    def present(self, t: Array) -> Mask:
        """Return, for each time, whether the signal was present and outside bad intervals."""
        gap = max(3.5 * self.period_s, 0.35)
        after = np.searchsorted(self.t, t)
        left = self.t[np.clip(after - 1, 0, len(self.t) - 1)]
        right = self.t[np.clip(after, 0, len(self.t) - 1)]
        there = (right - left <= gap) & (t >= self.t[0] - gap) & (t <= self.t[-1] + gap)
        return np.asarray(there & ~inside_of(t, self.bad, STEP_S))

    def good(self) -> Mask:
        """Return flags of the samples (N,) outside bad intervals."""
        return ~inside_of(self.t, self.bad)


@dataclass(frozen=True)
class DriveSignals:
    """A drive's channels and its grid."""

    t: Array
    channels: Mapping[str, Channel]
    knots: Channel
    """Signed speed, with at most one knot per step of the grid."""
    stops: tuple[Stop, ...]
    planar: bool
    """True if the accelerometer has no vertical axis."""

    @property
    def duration_s(self) -> float:
        """Duration [s]."""
        return float(len(self.t) * STEP_S)

    def has(self, name: str) -> bool:
        """True if the drive has a channel."""
        return name in self.channels


def inside_of(t: Array, spans: Spans, margin: float = 0.0) -> Mask:
    """Return flags of the times in the intervals. The intervals are extended by a margin [s] at
    both ends."""
    if not spans:
        return np.zeros(len(t), dtype=bool)
    start, stop = np.sort(np.array(spans), axis=0).T
    begun = np.searchsorted(start - margin, t, side="right")
    ended = np.searchsorted(stop + margin, t, side="left")
    return np.asarray(begun > ended)


def unusable(series: Series, period: float) -> Mask:
    """Return flags of the rows (N,) that no fit uses: duplicates, and rows with the same time stamp
    as the row before. With a coarse clock, the true time of such a row is not known."""
    again = duplicates(series, period)
    again[1:] |= np.diff(series.t) <= 0.0
    return again


def duplicates(series: Series, period: float) -> Mask:
    """Return flags of the rows (N,) that repeat the sample before: frames that were sent or logged
    twice."""
    t, values = series.t, series.values.reshape(len(series.t), -1)
    again = np.zeros(len(t), dtype=bool)
    if len(t) > 1:
        soon = (np.diff(t) < DUPLICATE_SHARE * period) & ~_goes_on_from_second(t, period)
        same = (np.diff(values, axis=0) == 0.0).all(axis=1)
        usual = _usual(same, soon)
        # So few samples may all repeat by chance, so they prove nothing.
        is_few = usual ** int(soon.sum()) >= CHANCE
        if is_few or binom.sf((soon & same).sum() - 1, soon.sum(), usual) < CHANCE:
            again[1:] = soon & same
    return again


def _goes_on_from_second(t: Array, period: float) -> Mask:
    """Return flags of the steps (N - 1,) after which the next frame comes one cycle after the
    second of two frames, and not one cycle after the first. In this case, the second frame was
    early or the sender's clock was set. In both cases, neither of the two frames is a duplicate."""
    made = np.zeros(len(t) - 1, dtype=bool)
    made[:-1] = np.abs(t[2:] - t[1:-1] - period) < np.abs(t[2:] - t[:-2] - period)
    return made


def _usual(same: Mask, soon: Mask) -> float:
    """Return the share of repeats among samples with normal spacing, near the samples that come too
    soon.

    A sensor with a dead zone repeats values at any spacing, and a sleeping sensor does so for a
    while. Such repeats are not duplicate frames. same, soon: (N - 1,) flags."""
    about, in_time = np.ones(2 * BESIDE + 1), ~soon
    if not in_time.any():
        return 0.0
    count = np.convolve(in_time.astype(float), about, "same")[soon]
    share = np.convolve((same & in_time).astype(float), about, "same")[soon]
    known = count > 0.5
    if not known.any():
        return float(same[in_time].mean())
    # The sum of trials with different chances scatters less than a binomial variable with their
    # mean chance.
    return float((share[known] / count[known]).mean())


def require(samples: Samples) -> None:
    """Raise EstimateError if a signal is missing that every diagnosis needs."""
    for name in NEEDED:
        if name not in samples or len(samples[name].t) < 20:
            raise EstimateError(f"the diagnosis needs some minutes of the signal {name!r}")


def drive_of(samples: Samples, bad: Mapping[str, Spans] | None = None) -> DriveSignals:
    """Put the signals of a drive on its grid. bad: intervals [s] by channel that must not be used.

    Raises EstimateError if a needed signal is missing.
    """
    require(samples)
    known = bad or {}
    channels = {
        name: Channel.from_series(series, known.get(name, ()))
        for name, series in samples.items()
        if len(series.t) >= 10
    }
    start = max(channels[name].t[0] for name in NEEDED)
    stop = min(channels[name].t[-1] for name in NEEDED)
    if stop - start < 45.0:
        raise EstimateError("the diagnosis needs at least 45 s with both accelerometer and speed")
    t = np.asarray(start + STEP_S * np.arange(int((stop - start) / STEP_S)))
    knots = _knots(channels, t)
    planar = bool(np.ptp(channels["accel"].values[:, 2]) == 0.0)
    return DriveSignals(t, channels, knots, _stops(channels, knots, t), planar)


def _knots(channels: Mapping[str, Channel], t: Array) -> Channel:
    """Return the signed speed at the times of its samples."""
    speed = channels["speed"]
    if speed.period_s < 0.8 * STEP_S:
        at, values = t, speed.means(t)
    else:
        at, values = speed.t, speed.values
    if "reverse" in channels:
        reverse = channels["reverse"]
        index = np.clip(np.searchsorted(reverse.t, at, side="right") - 1, 0, None)
        values = np.where(reverse.values[index] > 0.5, -values, values)
    return Channel.from_series(Series(at, values), speed.bad)


def _stops(channels: Mapping[str, Channel], knots: Channel, t: Array) -> tuple[Stop, ...]:
    """Return the standstills: the speed is 0, and the gyroscope moves no more than with an idling
    engine."""
    if "gyro" not in channels:
        return ()
    still = np.interp(t, knots.t, np.abs(knots.values)) < STANDING_MPS
    still &= channels["gyro"].present(t) & channels["accel"].present(t)
    rate, force = channels["gyro"].means(t), channels["accel"].means(t)
    found = []
    trim = max(TRIM_S, 1.2 * channels["speed"].period_s)
    for first, last in true_runs(still):
        low, high = t[first] + trim, t[last - 1] - trim
        inside = (t >= low) & (t <= high)
        if high - low < SHORTEST_STOP_S:
            continue
        if np.std(rate[inside], axis=0).max() > FASTEST_REST_RADPS:
            continue
        found.append(Stop(low, high, rate[inside].mean(axis=0), force[inside].mean(axis=0)))
    return tuple(found)
