"""Statistics of successive samples that do not depend on road and driver.

`CHANGES`: a road shakes all axes of a sensor. The size of one axis's changes over 1, 2, 4, ...
samples, relative to the other axes, depends on vehicle and sensor, so it is the same in two drives.

`changes_missing`, `jumps_alone`: small changes are more common than large changes in every signal,
also if each change is divided by the changes just before and after it.

`follows`: each segment of a drive gives six numbers without a unit: the shares of values that
repeat the previous value or continue a straight line, compared with chance, the tails of the
changes, and the share of a change that the next change reverses. A rougher road enlarges all
changes and does not change these numbers. A filter, a filled gap or a held value does. No equation
of motion shows such a change.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from math import comb

import numpy as np
from scipy.ndimage import maximum_filter1d
from scipy.special import erf
from scipy.stats import binom

from imucald.core.arrays import Array
from imucald.core.samples import INERTIAL
from imucald.core.text import counted
from imucald.diagnosis.cause_keys import TRIADS, mount_of
from imucald.diagnosis.direct.levels import (
    GAIN,
    OBD_STEP,
    OF_WHEELS,
    SAME,
    Numbers,
    levels_of,
    numbers_of,
    signals_of,
    step_of,
)
from imucald.diagnosis.direct.single_values import PASSES_HALF, noise_about
from imucald.diagnosis.fit.beside_file import ROAD_CLASS, Family, FamilyRow, Left, joined
from imucald.diagnosis.fit.blocks import LEAST_SHARE
from imucald.diagnosis.fit.chance import Answer, beyond_chance
from imucald.diagnosis.signals import STANDING_MPS, Channel, DriveSignals, Mask
from imucald.model.leaves import LAGS
from imucald.model.model import VehicleModel
from imucald.simulation.imu import mounts

ROUGHER = ROAD_CLASS**0.5
"""Largest factor between the changes of one axis and the changes of the other axes: half a road
class. A rougher road shakes all axes."""
SEGMENT_S = 10.0
LEAST_ROWS, MOVING_SHARE = 100, 0.8
"""Smallest number of rows of a segment, and share of the rows that must be in motion."""
BELOW_HALF = 1.0 / 3.0
"""Share of the changes that are below half of the largest change, for a pure vibration (arcsine
distribution). All other motions have a larger share."""
LEAST_CHANGES, LEAST_CODES, MOST_CODES = 30, 2, 1000
BESIDE = np.array([1.0] * 6 + [0.0] * 5 + [1.0] * 6)
"""Weights of the neighbouring changes with which a change is compared: the third to the eighth
change before it and after it. The two nearest changes on each side are not used, because a wrong
value and a filter after the sensor affect these changes."""
LEVELS = (4.0, 8.0, 16.0, 32.0, 64.0, 128.0)
"""Sizes of a change as multiples of the rms of the neighbouring changes, in octaves. In normal
noise, with the rms of twelve changes, one change in 500 exceeds the first size (Student's t
distribution)."""
ALONE_SHARE = 0.001
"""Share of a signal's changes that must be jumps. Shocks and stones cause a smaller share of jumps.
The same share of frames may come twice without a fault (`faults`)."""
SEGMENT_ROWS = 15
"""Smallest number of samples in a segment."""
FEW_SEGMENTS = 4
SHARE = 0.1
"""Largest difference between two correct drives in a share p, after the conversion arcsin(sqrt(p)).
The scatter of a converted share does not depend on p. From p = 0 to p = 0.01, the converted share
changes by 0.1."""


def changes_of(drives: Sequence[DriveSignals], model: VehicleModel) -> dict[float, Left]:
    """Return, by segment length [s], axis and rate, the mean speed (B,) of each segment and the
    relative size of its changes (B, lags). The relative size is the rms of the changes, divided by
    the geometric mean of the other axes' rms."""
    parts: dict[str, list[tuple[Array, Array]]] = {}
    for drive in drives:
        for name in TRIADS:
            if drive.has(name) and len(drive.channels[name].t) > LEAST_ROWS and not drive.planar:
                for own, found in _of_triad(name, drive, model):
                    parts.setdefault(own, []).append(found)
    return {SEGMENT_S: joined(parts)}


def _of_triad(
    name: str, drive: DriveSignals, model: VehicleModel
) -> Iterator[tuple[str, tuple[Array, Array]]]:
    channel = drive.channels[name]
    t, table = channel.t, channel.values @ mount_of(model).T
    for start, R in mounts(model.mount)[1:]:
        table[t >= start] = channel.values[t >= start] @ R.T
    good = channel.good()
    v = np.interp(t, drive.knots.t, np.abs(drive.knots.values))
    edges = np.searchsorted(t, np.arange(t[0], t[-1], SEGMENT_S))
    speeds, rows = [], []
    for a, b in pairwise(edges):
        inside = slice(a, b)
        if b - a < LEAST_ROWS or (v[inside] > STANDING_MPS).mean() < MOVING_SHARE:
            continue
        size = _sizes(t[inside], table[inside], good[inside], channel.period_s)
        if (size > 0.0).all():
            speeds.append(float(v[inside].mean()))
            rows.append(np.log(size))
    logs = np.reshape(rows, (-1, 3, len(LAGS)))
    rate = float(f"{1.0 / channel.period_s:.2g}")
    for i, axis in enumerate("xyz"):
        ratio = np.exp(1.5 * (logs[:, i] - logs.mean(axis=1)))  # of one to the two others
        yield f"changes of {name}_{axis} at {rate:g} Hz", (np.array(speeds), ratio)


def _sizes(t: Array, table: Array, good: Mask, period: float) -> Array:
    """Return the rms change (W, lags) of a table (N, W) over each lag; 0 if few changes are
    usable."""
    made = np.zeros((table.shape[1], len(LAGS)))
    for k, lag in enumerate(LAGS):
        there = (t[lag:] - t[:-lag] < (lag + 0.5) * period) & good[lag:] & good[:-lag]
        if there.sum() >= LEAST_ROWS // 2:
            made[:, k] = np.sqrt(np.mean((table[lag:] - table[:-lag])[there] ** 2, axis=0))
    return made


def _row(name: str, i: int) -> FamilyRow:
    """Return the test of one number. The number is tested in both directions. A difference that a
    road can cause on one axis is tolerated."""
    _, _, _, _, rate, _ = name.split()
    lag = counted(LAGS[i], "sample")
    rougher = float(np.log(ROUGHER))
    return FamilyRow(
        rougher,
        lambda middle, more: (
            f"in half of the segments its changes over {lag} at {rate} Hz are {middle:.2g} times "
            f"those of the other axes or more. That is {np.exp(more):.2g} times as much as in "
            "the drives of the model file. A road shakes all axes, and one axis at most "
            f"{ROUGHER:.2g} times as much as another"
        ),
        start=rougher,
        either_way=True,
    )


CHANGES = Family(_row)
"""Tests of the size of an axis's changes over several samples (`changes_of`)."""


# without a file ----------------------------------------------------------------------------------


def stays_until_off(name: str, channel: Channel) -> bool:
    """True if a signal is sent on change. A constant value of such a signal is not stuck."""
    asked = (a for signal in numbers_of(name, channel) for a in changes_missing(signal))
    return bool(beyond_chance(asked))


def changes_missing(signal: Numbers, _: VehicleModel | None = None) -> Iterator[Answer]:
    """Test one signal for missing small changes: does it stay constant until it changes by a large
    amount?

    Of all changes up to twice a size, at least a third must be below this size. All sizes are
    tested, and the chance is multiplied by their number."""
    step = step_of(levels_of(signal.values))
    changes = np.abs(np.diff(signal.values)[signal.is_next])
    changes = changes[changes > 0.0]
    if step == 0.0 or len(changes) < LEAST_CHANGES:
        return
    codes = np.round(changes / step).astype(int)
    counts = np.cumsum(np.bincount(np.minimum(codes, 2 * MOST_CODES)))
    # Lower half of 2 k - 1 codes; the middle code belongs to the upper half.
    half = np.arange(LEAST_CODES, min(MOST_CODES, len(counts) // 2))
    if not len(half):
        return
    below, all_ = counts[half - 1], counts[2 * half - 2]
    chance = binom.cdf(below, all_, BELOW_HALF)
    k = int(np.argmin(chance))
    many, size = int(all_[k]), float(half[k] * step)
    text = (
        f"{many} changes from one sample to the next are at most {2.0 * size:.2g} {signal.unit}. "
        f"{100.0 * below[k] / max(many, 1):.2g} % of them are below {size:.2g}; with any motion, "
        "a third or more would be. The signal keeps a value until its error is that large"
    )
    p = min(1.0, float(chance[k]) * len(half))
    # Below the noise, the steps of a coarse converter show instead.
    noise, sure = noise_about(signal.values), size if below[k] < 0.5 * BELOW_HALF * many else 0.0
    yield Answer(signal.name, size, noise, p, text, sure=sure, shown=1.0 / max(p, 1e-12))


def jumps_alone(signal: Numbers, _: VehicleModel) -> Iterator[Answer]:
    """Test one signal for repeated single jumps, with small changes before and after each jump.

    Consider the changes that are larger than their neighbours by some factor. At most a quarter of
    these changes are larger by twice the factor, because the tails of a distribution with a finite
    variance fall faster than 1/x^2. After a shock from the road, the vibration continues, so the
    neighbours of a shock are large too. Every pair of factors is tested, and the chance is
    multiplied by the number of pairs."""
    changes, times = _beside(signal)
    # A wrong value causes a jump there and one back: it counts once.
    times = times[times == maximum_filter1d(times, len(BESIDE), mode="constant")]
    counts = [int((times > level).sum()) for level in LEVELS]
    least = ALONE_SHARE * len(changes)
    asked = [
        (float(binom.sf(counts[j] - 1, counts[i], PASSES_HALF ** (j - i))), i, j)
        for i, j in combinations(range(len(LEVELS)), 2)
        if counts[j] > least
    ]
    chance, i, j = min(asked, default=(1.0, 0, 1))
    text = (
        f"it jumps {counts[j]} times by more than {LEVELS[j]:g} times its changes just before "
        f"and after. It jumps {counts[i]} times by more than {LEVELS[i]:g} times; with motion "
        f"and noise alone, at most {counts[i] * PASSES_HALF ** (j - i):.0f} of these jumps "
        "would be so large. Single values are wrong, or the signal switches between two "
        "sources"
    )
    p = min(1.0, chance * comb(len(LEVELS), 2))
    yield Answer(signal.name, float(counts[j]), least, p, text, shown=float(counts[j]))


def _beside(signal: Numbers) -> tuple[Array, Array]:
    """Return the changes (N,) between different values, and the ratio (N,) of their size to the rms
    of the neighbouring changes. This rms is at least the signal's noise or step. Speeds below 1
    km/h are left out, because a speed leaves zero with a jump (dead band)."""
    new = np.flatnonzero(np.concatenate([[True], np.diff(signal.values) != 0.0]))
    gaps = np.concatenate([[0], np.cumsum(~signal.is_next)])[new]
    x = signal.values[new]
    there = np.diff(gaps) == 0
    if signal.channel in OF_WHEELS:
        there &= np.minimum(np.abs(x[1:]), np.abs(x[:-1])) > OBD_STEP
    changes = np.diff(x) * there
    least = max(step_of(levels_of(x)), noise_about(signal.values))
    if len(changes) < len(BESIDE):
        return changes[:0], changes[:0]
    if least == 0.0:
        # With few samples and no grid neither noise nor step is known: the median change is used.
        least = float(np.median(np.abs(changes)))
    power = np.convolve(changes**2, BESIDE, "same")
    count = np.convolve(there.astype(float), BESIDE, "same")
    rms = np.sqrt(power / np.maximum(count, 1.0) + least**2)
    return changes, np.abs(changes) / rms


@dataclass(frozen=True)
class Trait:
    """Description of one of the six numbers. limit: largest difference between two correct
    drives."""

    more: str
    less: str
    limit: float

    @property
    def unit(self) -> str:
        """Unit of the differences of this number."""
        return "(arcsine of the root of the share)" if self.limit == SHARE else "in the logarithm"


TRAITS = (
    Trait("repeats the previous sample more often", "repeats the previous sample less often",
          SHARE),
    Trait("continues along a straight line more often",
          "continues along a straight line less often", SHARE),
    # rms over mean size: 1.25 for a normal distribution, 1.41 for a double exponential one.
    Trait("has more very large changes", "has fewer very large changes", 0.12),
    Trait("has more very large second differences",
          "has fewer very large second differences",
          0.12),
    # The second difference is 1.73 times the first for white noise, 1.41 times for a random walk.
    Trait("reverses a larger part of each change",
          "reverses a smaller part of each change", 0.2),
    # The change over four samples is 1 time a single change for white noise, 2 times for a random
    # walk.
    Trait("continues further in the direction of a change",
          "continues less far in the direction of a change", 0.7),
)  # fmt: skip
"""The descriptions in the order of the six numbers."""


def traits_of(drives: Sequence[DriveSignals]) -> dict[float, Left]:
    """Return, by segment length [s] and name, the mean speed of each segment (B,) and the
    exponentials of the six numbers (B, 6). The mean speed is 0 for signals for which the speed does
    not matter."""
    made: dict[float, dict[str, list[tuple[Array, Array]]]] = {}
    for drive in drives:
        for signal in signals_of(drive):
            period = drive.channels[signal.channel].period_s
            seconds = max(SEGMENT_S, float(f"{SEGMENT_ROWS * period:.2g}"))
            v, numbers = _of_signal(signal, drive, period, seconds)
            name = f"samples of {signal.name} at {1.0 / period:.2g} Hz"
            made.setdefault(seconds, {}).setdefault(name, []).append((v, np.exp(numbers)))
    return {seconds: joined(of) for seconds, of in made.items()}


def _of_signal(
    signal: Numbers, drive: DriveSignals, period: float, seconds: float
) -> tuple[Array, Array]:
    """Return the speeds (B,) and the six numbers (B, 6) for the segments of a signal."""
    t, x, n = signal.t, signal.values, signal.is_next
    if len(x) < SEGMENT_ROWS:
        return np.zeros(0), np.zeros((0, len(TRAITS)))
    place = ((t - t[0]) / seconds).astype(np.intp)
    count = int(place[-1]) + 1
    v = np.interp(t, drive.knots.t, np.abs(drive.knots.values))
    rows, speed = np.bincount(place, minlength=count), np.bincount(place, v, count)
    moving = np.bincount(place, v > STANDING_MPS, count)
    step = step_of(levels_of(x))
    same = SAME * max(1.0, float(np.abs(x).max()))

    def mean(values: Array, there: Mask) -> Array:
        own = place[: len(there)][there]
        number = np.bincount(own, minlength=count)
        return np.asarray(np.bincount(own, values[there], count) / np.maximum(number, 1))

    one, two, four = np.diff(x), np.diff(x, 2), x[4:] - x[:-4]
    there_1, there_2 = n, n[1:] & n[:-1]
    there_4 = n[3:] & n[2:-1] & n[1:-2] & n[:-3]
    stays = np.abs(one) <= same
    line = (np.abs(two) <= max(0.51 * step, same)) & ~stays[1:] & ~stays[:-1]
    size_1, size_2 = mean(np.abs(one), there_1), mean(np.abs(two), there_2)
    rms_1, rms_2 = np.sqrt(mean(one**2, there_1)), np.sqrt(mean(two**2, there_2))
    rms_4 = np.sqrt(mean(four**2, there_4))
    repeats, lines = mean(stays.astype(float), there_1), mean(line.astype(float), there_2)
    good = (rows >= LEAST_SHARE * seconds / period) & (moving >= LEAST_SHARE * rows)
    good &= (rms_1 > 0.0) & (rms_2 > 0.0) & (rms_4 > 0.0)
    size_1, size_2, rms_1, rms_2, rms_4 = (a[good] for a in (size_1, size_2, rms_1, rms_2, rms_4))
    repeats, lines = repeats[good], lines[good]
    numbers = np.column_stack([
        _arcsine(repeats) - _arcsine(_by_chance(step, size_1)),
        _arcsine(lines) - _arcsine(_by_chance(step, size_2) * (1.0 - repeats)),
        np.log(rms_1 / size_1), np.log(rms_2 / size_2), np.log(rms_2 / rms_1),
        np.log(rms_4 / rms_1),
    ])  # fmt: skip
    is_speed = signal.channel in OF_WHEELS
    return speed[good] / rows[good] * is_speed, numbers


def _by_chance(step: float, size: Array) -> Array:
    """Return the share (B,) of normally distributed values that are below half a step. size: (B,)
    mean size of the values."""
    return np.asarray(erf(step / (2.0 * np.sqrt(np.pi) * size)))


def _arcsine(share: Array) -> Array:
    return np.asarray(np.arcsin(np.sqrt(np.clip(share, 0.0, 1.0))))


def follows(drives: Sequence[DriveSignals], stated: VehicleModel) -> Family:
    """Return the tests that compare these numbers with the numbers of the model file's own
    drives."""
    same = _on_the_files_grid(drives, stated)
    return Family(lambda name, i: _trait_row(name.split()[2], TRAITS[i], same), FEW_SEGMENTS)


def _on_the_files_grid(drives: Sequence[DriveSignals], stated: VehicleModel) -> set[str]:
    """Return the names of the signals whose levels have the same spacing as in the drives of the
    model file, up to a gain error. Signals without a grid in these drives and in the drives of the
    model file are also included. A signal with other levels, for example a rotated signal, has
    another rate of repeats."""
    same: set[str] = set()
    for drive in drives:
        for signal in signals_of(drive):
            file = stated.leaves.get(f"levels of {signal.channel}")
            if file is None:
                continue
            step, known = step_of(levels_of(signal.values)), file.spread[0] < file.rms[0]
            near = file.rms[0] / GAIN <= step <= GAIN * file.rms[0]
            if near if known else step == 0.0:
                same.add(signal.name)
    return same


def _trait_row(signal: str, trait: Trait, on_grid: Collection[str]) -> FamilyRow | None:
    # The changes of a speed depend on the driver, but its repeats do not.
    is_asked = signal.partition("_")[0] in INERTIAL or trait is TRAITS[0]
    if not is_asked or (trait.limit == SHARE and signal not in on_grid):
        return None
    return FamilyRow(
        trait.limit,
        lambda _, more: (
            f"it {trait.more if more > 0.0 else trait.less} than in the drives of the model "
            f"file: by {abs(more):.2g} {trait.unit}, and roads and driving make at most "
            f"{trait.limit:g}. The sensor's filter, a gateway or the logger has changed the samples"
        ),
        either_way=True,
        in_times=False,
    )
