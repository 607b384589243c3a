"""Find slow signals that are stuck: frames are received, but their value does not change.

`motion.recorded_health` tests sensors, whose values always change because of noise. A slow signal
is stuck if it stays at one value longer than it normally does and ends this stay with a large
change. A speed is stuck only if the inertial sensors contradict it: on a motorway, a coarse speed
stays at one value for minutes.

A stay is a run of equal values. The probability that a stay goes on is drawn from a beta
distribution, once for each stay, because stays are longer at constant speed than in town. The
lengths then have a beta-geometric distribution (Waring's distribution; Weinberg and Gladen 1986),
with a tail n^-b.

The speed is predicted from accelerometer and gyroscope. The residual contains noise and the effect
of the road. If the speed signal repeats an old value, the residual is as large as the hidden change
of speed. The mount is not known here, so the relation of the speed to the three axes is fitted.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaln
from scipy.stats import chi2
from scipy.stats import t as student

from imucald.core.arrays import Array, true_runs
from imucald.core.samples import INERTIAL, Samples, Series
from imucald.core.text import counted
from imucald.diagnosis.signals import CHANCE, DRIVING_MPS, Channel, Mask, Spans

Index = NDArray[np.intp]
FEW_STAYS = 20
"""Smallest number of stays for which the tail is also estimated from the longest stays."""
LONGEST = 0.1
"""Share of the longest stays for a separate estimate of the tail (peaks over a threshold, Pickands
1975)."""
STEP_S = 0.2
PART_S = 20.0
"""Length of the parts of a long interval that are compared with windows of the drive [s]."""
LEAST_WINDOWS = 8
"""Smallest number of windows of the same length with which an interval is compared."""
STUCK = "stuck_signal"
STUCK_S = 8.0
"""Shortest time [s] that counts as stuck for a signal that may keep its value."""


def number_as_long(own: Index, length: int) -> float:
    """Return the expected number of a drive's stays that last at least this long. The result is the
    larger of two estimates: one from all stays, the other from the longest stays.

    own: (M,) lengths [steps, >= 1] of all stays of this drive except the tested stay. length:
    length of the tested stay [steps]. Without other stays the result is 1, because a filter that
    settles for the first time may stay for any time.
    """
    if not len(own):
        return 1.0
    ends = [1]
    if len(own) > FEW_STAYS:
        ends.append(int(np.sort(own)[-max(FEW_STAYS, round(LONGEST * len(own)))]))
    return max(_beyond(own[own >= end] - end, max(length - end, 0)) for end in ends)


def _beyond(more: Index, length: int) -> float:
    """Return the expected number as in `number_as_long`, for the part of the stays beyond a
    threshold, from the posterior of a and b. The prior is uniform in 1/b and in the mean
    probability a/(a + b). b is above 1, so that the mean length of a stay is finite.

    P(L >= n) = B(a + n, b)/B(a, b), P(L = n) = B(a + n, b + 1)/B(a, b).
    """
    grid = (np.arange(40) + 0.5) / 40.0
    goes_on, one_over_b = np.meshgrid(grid, grid, indexing="ij")
    b = 1.0 / one_over_b
    a = goes_on / (1.0 - goes_on) * b
    logs = np.zeros_like(a)
    for n, count in zip(*np.unique(more, return_counts=True), strict=True):
        logs += count * (betaln(a + n, b + 1.0) - betaln(a, b))
    weights = np.exp(logs - logs.max())
    tail = np.exp(betaln(a + length, b) - betaln(a, b))
    return float(np.average(tail, weights=weights)) * (len(more) + 1)


def chance_of_any(product: float, count: int, asked: int) -> float:
    """Return the chance that any of the tested stays has such a small product of the expected
    number and the other chances.

    count: number of factors. The first factor is `asked` times the chance of the stay's length. The
    chances are combined as independent chances (Fisher 1925) and corrected for the number of tested
    stays.
    """
    logs = -2.0 * np.log(max(product / asked, 1e-300))
    return min(1.0, asked * float(chi2.sf(logs, 2 * count)))


def chances_of_sensors(samples: Samples, spans: Spans) -> tuple[Array, Array]:
    """Return two chances (S,) of the sensors' signals in each interval of constant speed: if the
    true speed is constant, and if it changes as in other parts of the drive. NaN if the sensors do
    not cover an interval.

    The logarithm of the interval's residual is compared with the residuals of windows in motion
    (Student's t distribution of one further value), and with the residuals that these windows would
    have if their speed were stuck. Long intervals are divided into parts, so that there are enough
    windows. No window contains part of another interval.
    """
    made = np.full((2, len(spans)), np.nan)
    if not spans or "accel" not in samples:
        return made[0], made[1]
    t, signals = _signals(samples)
    for k, (low, high) in enumerate(spans):
        parts = max(1, round((high - low) / PART_S))
        n = round((high - low) / STEP_S / parts)
        first = int(np.searchsorted(t, low))
        if not len(t) or low < t[0] - STEP_S or first + parts * n > len(t):
            continue
        starts = _windows(t, signals[:, 0], n, spans)
        if len(starts) < LEAST_WINDOWS or n < 2 * signals.shape[1]:
            continue
        windows = np.array([_detrended(signals[i : i + n]) for i in starts])
        places = [first + part * n for part in range(parts)]
        own = np.array([_detrended(signals[i : i + n]) for i in places])
        moving, stuck_there, here = (np.log(x) for x in _left(windows, own))
        made[0, k] = 1.0 - _below(here, moving)
        made[1, k] = _below(here, stuck_there)
    return made[0], made[1]


def _below(here: Array, usual: Array) -> float:
    """Return the chance that the mean of as many further values of `usual` is below that of
    `here`."""
    spread = float(np.std(usual, ddof=1)) * np.sqrt(1.0 / len(here) + 1.0 / len(usual))
    apart = float(here.mean() - usual.mean()) / max(spread, 1e-12)
    return float(student.cdf(apart, len(usual) - 1))


def _signals(samples: Samples) -> tuple[Array, Array]:
    """Return the time grid (N,), and on this grid the speed and its regressors (N, 1 + 3 or 6). The
    regressors are the integral of the force, and the double integral of the angular rate for the
    rotation of gravity."""
    speed, accel = samples["speed"], samples["accel"]
    t = np.arange(max(speed.t[0], accel.t[0]), min(speed.t[-1], accel.t[-1]), STEP_S)
    columns = [np.interp(t, speed.t, speed.values)[:, None]]
    columns.append(_integral(Channel.from_series(accel).means(t, STEP_S)))
    if "gyro" in samples:
        rate = Channel.from_series(samples["gyro"]).means(t, STEP_S)
        columns.append(_integral(_integral(rate)))
    return t, np.concatenate(columns, axis=1)


def _integral(x: Array) -> Array:
    area = np.cumsum(0.5 * (x[1:] + x[:-1]), axis=0) * STEP_S
    return np.concatenate([np.zeros_like(x[:1]), area])


def _windows(t: Array, v: Array, n: int, spans: Spans) -> list[int]:
    """Return the first rows of consecutive windows of n rows in motion. No window contains part of
    an interval. After a stop in a window, the next window begins a quarter of a window later."""
    good = v > DRIVING_MPS
    for low, high in spans:
        good &= (t < low) | (t > high)
    bad = np.concatenate([[0], np.cumsum(~good)])
    starts, i = [], 0
    while i + n <= len(t):
        is_clear = bad[i + n] == bad[i]
        if is_clear:
            starts.append(i)
        i += n if is_clear else max(n // 4, 1)
    return starts


def _detrended(rows: Array) -> Array:
    """Return the rows without mean and slope. Mean and slope contain the start value, and the
    effects of a zero error and of a constant road slope."""
    line = np.column_stack([np.ones(len(rows)), np.linspace(-1.0, 1.0, len(rows))])
    return np.asarray(rows - line @ np.linalg.lstsq(line, rows, rcond=None)[0])


def _left(windows: Array, own: Array) -> tuple[Array, Array, Array]:
    """Return the rms residuals of the speed [m/s]: (W,) of each window, (W,) of the same windows if
    their speed were stuck, and (K,) of each tested part.

    windows: (W, n, 1 + k): the speed, then k regressors, at n times of each window in motion. own:
    (K, n, 1 + k), the same of the tested parts. The regression of the speed on the regressors is
    fitted to the windows only.
    """
    gram = np.einsum("wni,wnj->ij", windows, windows)
    ridge = 1e-9 * np.diag(np.diag(gram)[1:]) + 1e-30 * np.eye(len(gram) - 1)
    b = np.linalg.solve(gram[1:, 1:] + ridge, gram[1:, 0])

    def rms(x: Array) -> Array:
        return np.asarray(np.maximum(np.sqrt(np.mean(x**2, axis=1)), 1e-9))

    felt = windows[:, :, 1:] @ b
    return rms(windows[:, :, 0] - felt), rms(felt), rms(own[:, :, 0] - own[:, :, 1:] @ b)


@dataclass(frozen=True)
class Fault:
    """A fault of one signal."""

    cause: str
    signal: str
    values: Mapping[str, tuple[float, float, str]]
    """Value, deviation and unit, by key."""
    text: str
    changes: Mapping[str, Any]
    """Changes of the model file that state the fault."""
    spans: Spans = ()
    """Intervals of time [s] that must not be used."""
    score: float = 50.0
    """Evidence [nats], if known."""
    against: tuple[str, ...] = ()
    """Arguments against the fault, as sentences. A fault with such an argument is likely and not
    certain."""


def stuck(
    name: str, series: Series, samples: Samples, moving: tuple[Array, Array]
) -> Iterator[Fault]:
    """Yield a fault if a slow signal has intervals with one constant value while the vehicle moves.

    Slow signals are signals that may keep their value for seconds: speed, steering angle. Zeros at
    rest are normal."""
    t, table = series.t, series.values.reshape(len(series.t), -1)
    same = (np.diff(table, axis=0) == 0.0).all(axis=1)
    first, last = true_runs(same).T
    if not len(first):
        return
    # Missing frames are another fault.
    length = np.minimum(t[last] - t[first], (last - first) * float(np.median(np.diff(t))))
    # Only time in motion counts; a long interval may contain stops. A speed of 0 does not show
    # whether the vehicle moves.
    steps = np.diff(t) * (np.interp(0.5 * (t[1:] + t[:-1]), *moving) > DRIVING_MPS)
    driven = np.concatenate([[0.0], np.cumsum(steps)])
    stays = [(float(t[a]), float(t[b])) for a, b in zip(first, last, strict=True)]
    is_zero = (name == "speed") & (table[first, 0] == 0.0)
    length = np.where(is_zero, length, np.minimum(length, driven[last] - driven[first]))
    asked = np.flatnonzero(length > STUCK_S)
    felt = np.full(len(stays), np.nan)
    if name == "speed":
        sound, held = chances_of_sensors(samples, tuple(stays[k] for k in asked))
        # The sensors may speak for a constant speed too: a cruise is longer than other stays.
        felt[asked] = sound / np.maximum(held, 1e-300)
        asked = asked[np.isfinite(felt[asked])]
    is_unusual = _chances(t, table[:, 0], last, length, is_zero, asked, felt) < CHANCE
    spans = [
        stays[k]
        for k in np.flatnonzero(is_unusual)
        if is_zero[k] or not is_shown_often(series, stays[k])
    ]
    if sum(b - a for a, b in spans) >= STUCK_S:
        yield stuck_fault(name, spans)


def stuck_fault(name: str, spans: Sequence[tuple[float, float]]) -> Fault:
    """Return the fault of a signal that repeats one value in these intervals of time [s]."""
    total = sum(b - a for a, b in spans)
    gaps = tuple({"start_s": max(a, 0.0), "duration_s": b - a} for a, b in spans)
    least = 1.0 if name in INERTIAL else STUCK_S
    return Fault(
        STUCK, name, {f"_{name}.stuck_s": (total, 0.0, "s")},
        f"Frames come, but the value does not change for {total:.1f} s in "
        f"{counted(len(spans), 'piece')} of driving, from {spans[0][0]:.0f} s on.",
        {f"{name}.stuck": gaps}, tuple(spans), 5.0 * total / least,
    )  # fmt: skip


def is_shown_often(series: Series, span: tuple[float, float]) -> bool:
    """Return whether most other stays of a signal have the same value as an interval of time. The
    value is then a dead zone, and the signal is not stuck."""
    t, table = series.t, series.values.reshape(len(series.t), -1)
    first = true_runs((np.diff(table, axis=0) == 0.0).all(axis=1))[:, 0]
    inside = (t >= span[0]) & (t <= span[1])
    others = first[~inside[first]]
    if len(others) < 3:
        return False
    return bool((table[others] == table[inside][0]).all(axis=1).mean() > 0.5)


def _chances(
    t: Array, x: Array, last: Index, length: Array, is_zero: Mask, asked: Index, felt: Array
) -> Array:
    """Return the chance (S,) that any stay of a healthy slow signal x (N,) is as unusual as this
    stay. 1 for stays that are not tested.

    A stay is unusual if it is long, ends with a large change, and contradicts the inertial sensors.
    last: rows at which the stays end. length: length of each stay while driving [s]. is_zero:
    stays at zero speed. A vehicle may stand for any time, so only the sensors judge them. felt: how
    much likelier the inertial sensors' signals are with a sound than with a stuck signal; NaN if
    they give no evidence.
    """
    made = np.ones(len(length))
    if not len(asked):
        return made
    steps = np.round(length / np.median(np.diff(t))).astype(np.intp)
    changes = np.abs(np.diff(x))
    ends = last < len(changes)
    for k in asked:
        if is_zero[k]:
            made[k] = chance_of_any(len(asked) * float(felt[k]), 1, len(asked))
            continue
        others = (steps > 0) & ~is_zero
        others[k] = False
        factors = [number_as_long(steps[others], int(steps[k]))]
        if ends[k]:
            like = changes[last[others & ends]]
            own = like if len(like) > FEW_STAYS else changes[changes > 0.0]
            # Chance of a change at least as large, by its rank.
            factors.append(float((1 + (own >= changes[last[k]]).sum()) / (len(own) + 1)))
        if np.isfinite(felt[k]):
            factors.append(float(felt[k]))
        made[k] = chance_of_any(float(np.prod(factors)), len(factors), len(asked))
    return made
