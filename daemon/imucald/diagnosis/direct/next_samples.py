"""Statistics of successive samples that do not depend on road and driver.

Each segment of a drive gives six numbers without a unit. The first number is the share of values
that repeat the previous value. The second number is the share of values that continue the straight
line of the two previous values. Both shares are compared with chance for this step and noise. The
other four numbers describe the tails of the changes, and the share of a change that the next change
reverses. A road of the next roughness class enlarges all changes and does not change these numbers.
A model file contains the medians over the segments of its drives. These numbers show a change
between sensor and log, such as a filter, a filled gap or a held value. No equation of motion shows
such a change.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import erf

from imucald.core.arrays import Array
from imucald.core.samples import INERTIAL
from imucald.diagnosis.direct.levels import (
    GAIN,
    OF_WHEELS,
    SAME,
    Numbers,
    levels_of,
    signals_of,
    step_of,
)
from imucald.diagnosis.fit.beside_file import Family, FamilyRow, Left, joined
from imucald.diagnosis.signals import STANDING_MPS, DriveSignals, Mask
from imucald.model.model import VehicleModel

SEGMENT_S, SEGMENT_ROWS = 10.0, 15
"""Length of a segment [s], and smallest number of samples in a segment."""
LEAST_SHARE = 0.6
"""Share of a segment's samples that must be present, and share that must be recorded in motion."""
FEW_SEGMENTS = 4
SHARE = 0.1
"""Largest difference between two correct drives in a share p, after the conversion arcsin(sqrt(p)).
The scatter of a converted share does not depend on p. From p = 0 to p = 0.01, the converted share
changes by 0.1."""


@dataclass(frozen=True)
class Trait:
    """Description of one of the six numbers. limit: largest difference between two correct
    drives."""

    more: str
    less: str
    limit: float
    unit: str = "in the logarithm"
    of_speed: bool = False
    """True if the number is also tested for speeds, whose changes depend on the driver."""


OF_SHARE = "(arcsine of the root of the share)"
TRAITS = (
    Trait("repeats the previous sample more often", "repeats the previous sample less often",
          SHARE, OF_SHARE, of_speed=True),
    Trait("continues along a straight line more often",
          "continues along a straight line less often",
          SHARE, OF_SHARE),
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
        own, number = (
            place[: len(there)][there],
            np.bincount(place[: len(there)][there], minlength=count),
        )
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
    return Family(lambda name, i: _row(name.split()[2], TRAITS[i], same), FEW_SEGMENTS)


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


def _row(signal: str, trait: Trait, on_grid: Collection[str]) -> FamilyRow | None:
    is_inertial = signal.partition("_")[0] in INERTIAL
    if not (is_inertial or trait.of_speed) or (trait.limit == SHARE and signal not in on_grid):
        return None
    return FamilyRow(
        trait.limit,
        lambda _, more: (
            f"it {trait.more if more > 0.0 else trait.less} than in the drives of the model "
            f"file: by {abs(more):.2g} {trait.unit}, and roads and driving make at most "
            f"{trait.limit:g}. Something between the sensor and the log has changed"
        ),
        either_way=True,
        in_times=False,
    )
