"""What the values of a signal show by themselves: the levels of its converter.

A converter, or who sends on what it says, has levels that lie one step apart. Where a later drive
comes in coarser steps than those that a model file was made of, or says 0 up to a higher value,
something stands between that was not there; and a range that a signal jumps over again and again,
and never shows, is missing. A model file that was extended carries the levels of its own drives.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import msgspec
import numpy as np
from scipy.stats import binom

from imucald.core.arrays import Array
from imucald.core.samples import QUANTITIES
from imucald.diagnosis.causes import PARAMETERS
from imucald.diagnosis.fit.beside_file import short, six, with_entries
from imucald.diagnosis.fit.chance import Question
from imucald.diagnosis.result import COARSER, VALUES_MISSING, Structure
from imucald.diagnosis.signals import Channel, DriveSignals, Mask
from imucald.model.leaves import GAP_QUANTILES, Leaves
from imucald.model.model import VehicleModel

SIGNALS = (
    "accel", "gyro", "speed", "wheel_speeds", "steering", "yaw_rate", "lateral_accel",
    "longitudinal_accel",
)  # fmt: skip
"""Signals that are asked."""
OF_WHEELS = ("speed", "wheel_speeds")
"""Signals that say 0 below some speed."""
NEAR_STEPS, OFF_STEP, ON_STEPS = 5.5, 0.1, 0.9
"""Levels are those of a converter where of gaps of up to so many steps this share are whole ones
within a tenth: of gaps of any width a fifth are."""
LEAST_GAPS = 10
SAME = 1e-9
"""Of a signal's largest value: levels closer than that are one, rounded twice."""
GAIN = 1.0 + max(row.plausible[1] for key, row in PARAMETERS.items() if ".scale" in key)
"""What a wrong gain may make of a step: the largest that is plausible."""
OBD_STEP = 1.0 / 3.6
"""One bit of a vehicle's speed [m/s] (SAE J1979, PID 0x0D)."""
FEW_CHANGES = 0.25
"""Share of a signal's changes that its own noise makes, whatever holes it jumps over."""
LEAST_CODES = 2
"""Codes that a hole has, at least: single ones may be missing of any converter."""


@dataclass(frozen=True)
class Numbers:
    """One number of a signal, without rows that repeat the whole of the one before."""

    name: str
    """As in structures: `accel_x`, `speed`."""
    channel: str
    unit: str
    t: Array
    values: Array
    """(N,), in the channel's unit."""
    is_next: Mask
    """(N - 1,) whether the row after each is the next one that was sent."""


def signals_of(drive: DriveSignals) -> Iterator[Numbers]:
    """Each number of each signal of a drive, without what faults make invalid."""
    for name in SIGNALS:
        if drive.has(name):
            yield from numbers_of(name, drive.channels[name])


def numbers_of(name: str, channel: Channel) -> Iterator[Numbers]:
    """Each number of a signal."""
    good = channel.good()
    t, table = channel.t[good], channel.values.reshape(len(channel.t), -1)[good]
    if len(t) < 2:
        return
    is_next = np.diff(t) < 1.5 * channel.period_s
    for i, x in enumerate(table.T):
        letters = "xyz" if table.shape[1] == 3 else "0123"
        own = name if table.shape[1] == 1 else f"{name}_{letters[i]}"
        yield Numbers(own, name, QUANTITIES[name].unit, t, x, is_next)


# levels ------------------------------------------------------------------------------------------


def levels_of(x: Array) -> Array:
    """(L,) levels that occur, rising."""
    found = np.unique(x)
    apart = np.diff(found) > SAME * max(1.0, float(np.abs(found).max()))
    return np.asarray(found[np.concatenate([[True], apart])])


def finest_of(levels: Array) -> float:
    """Gap between levels that all but a tenth reach; 0 where there are few."""
    gaps = np.diff(levels)
    return (
        float(np.quantile(gaps, GAP_QUANTILES[0], method="lower"))
        if len(gaps) >= LEAST_GAPS
        else 0.0
    )


def step_of(levels: Array) -> float:
    """Step of the converter that these levels come of; 0 where they lie on no common grid."""
    gaps, step = np.diff(levels), finest_of(levels)
    if step == 0.0:
        return 0.0
    near = gaps[gaps < NEAR_STEPS * step] / step
    whole = np.abs(near - np.round(near)) <= OFF_STEP
    return step if len(near) >= LEAST_GAPS and whole.mean() >= ON_STEPS else 0.0


def is_one_grid(levels: Array, step: float) -> bool:
    """Whether all levels lie on one grid, from end to end. Readings that were turned after being
    rounded lie in heaps: their gaps are equal, and add up to no grid."""
    code = np.cumsum(np.round(np.diff(levels, prepend=levels[0]) / step))
    slope, start = np.polyfit(code, levels, 1)
    off = np.abs(levels - start - slope * code)
    return bool((off <= OFF_STEP * step).mean() >= ON_STEPS)


# against the file --------------------------------------------------------------------------------


def coarser(drives: Sequence[DriveSignals], stated: VehicleModel) -> list[Question]:
    """Whether signals come in coarser steps than the file's drives, or say 0 up to more."""
    asked: list[Question] = []
    for drive in drives:
        for signal in signals_of(drive):
            file = stated.leaves.get(f"levels of {signal.channel}")
            if file is not None:
                asked += _in_steps(signal, file.rms[0], file.spread[0])
                if signal.channel in OF_WHEELS:
                    asked += _from_zero(signal, file.speeds_mps[0])
    return asked


def _in_steps(signal: Numbers, lsb: float, known_to: float) -> Iterator[Question]:
    """Of gaps between levels that occur, at most the finest tenth are narrower than a step. On the
    file's grid, of which as many levels occur, far more would be."""
    levels = levels_of(signal.values)
    step = step_of(levels)
    if lsb == 0.0 or step <= GAIN * (lsb + known_to):
        return
    ratio = step / lsb
    gaps = np.diff(levels)
    # One in `ratio` of the file's levels occurs: so often another comes before the step is over.
    narrow = 1.0 - (1.0 - 1.0 / ratio) ** (np.ceil(ratio - OFF_STEP) - 1.0)
    fewer = int((gaps < (1.0 - OFF_STEP) * step).sum())
    p = float(binom.cdf(fewer, len(gaps), narrow))
    text = (
        f"its values come in steps of {step:.3g} {signal.unit}, {ratio:.2g} times as large as "
        f"in the drives of the model file ({lsb:.3g}). The model file does not contain the "
        f"rounding error of {step / 12**0.5:.2g} {signal.unit}"
    )
    yield Question(p, True, Structure(signal.name, COARSER, ratio, text))


def _from_zero(signal: Numbers, dead: float) -> Iterator[Question]:
    """What a signal shows next to 0, each time that it leaves or reaches it. Where values come as
    often in each range of one width, n of them between the least and twice that have a chance of
    2^-n, whatever the rate (least of a Poisson process: the integral of e^-u P(N >= n | u))."""
    x = np.abs(signal.values)
    low, high = np.minimum(x[1:], x[:-1]), np.maximum(x[1:], x[:-1])
    beside = high[(low == 0.0) & (high > 0.0) & signal.is_next]
    if not len(beside):
        return
    least = float(x[x > 0.0].min())
    many = int((beside < 2.0 * least - dead).sum())
    text = (
        f"it shows 0 up to {least:.2g} m/s; in the drives of the model file it shows 0 up to "
        f"{dead:.2g} m/s. It left or reached 0 {len(beside)} times, and never at a lower speed"
    )
    is_large = least > 2.0 * dead and least - dead > OBD_STEP
    structure = Structure(signal.name, VALUES_MISSING, least / max(dead, 1e-3), text)
    yield Question(0.5**many, is_large, structure)


# without a file ----------------------------------------------------------------------------------


def holes(drives: Sequence[DriveSignals]) -> list[Question]:
    """Ranges that a signal jumps over and never shows."""
    return [q for drive in drives for signal in signals_of(drive) for q in _hole(signal)]


def _hole(signal: Numbers) -> Iterator[Question]:
    """The hole that is jumped over most often. A change from sample to sample is the less likely
    the larger it is; so from a place below a hole, no further away than it is wide, it is as easy
    to land in it as above it, no further away: each such jump has a chance of a half. A vehicle
    that stands and then sets off is no such place: speeds are asked from 1 km/h on."""
    levels = levels_of(signal.values)
    step = step_of(levels)
    if step == 0.0 or not is_one_grid(levels, step):
        return
    x = signal.values
    low = np.minimum(x[1:], x[:-1])[signal.is_next]
    high = np.maximum(x[1:], x[:-1])[signal.is_next]
    changes = (high - low)[high - low > 0.5 * step]
    if not len(changes):
        return
    # Who rounds twice leaves out codes all over.
    twice = (LEAST_CODES + 0.5) * max(step, float(np.median(np.diff(levels))))
    least = max(twice, float(np.quantile(changes, FEW_CHANGES)))
    wide = [
        (a, b)
        for a, b in pairwise(levels)
        if b - a > least and not (signal.channel in OF_WHEELS and a < OBD_STEP)
    ]
    best, jumps = (0.0, 0.0), 0
    for a, b in wide:
        over = (low < a + 0.5 * step) & (high > b - 0.5 * step)
        over &= (low > 2.0 * a - b) & (high < 2.0 * b - a)
        if int(over.sum()) > jumps:
            best, jumps = (float(a), float(b)), int(over.sum())
    if not jumps:
        return
    text = (
        f"it jumps {jumps} times across the range from {best[0]:.3g} to {best[1]:.3g} "
        f"{signal.unit}, and never shows a value inside it"
    )
    p = min(1.0, len(wide) * 0.5**jumps)
    yield Question(p, True, Structure(signal.name, VALUES_MISSING, float(jumps), text))


# writing -----------------------------------------------------------------------------------------


def with_levels(model: VehicleModel, drives: Sequence[DriveSignals]) -> VehicleModel:
    """The model file with the levels in which these drives' signals come, of each signal those that
    lie closest, and the least speed above 0."""
    made: dict[str, Leaves] = {}
    for drive in drives:
        for signal in signals_of(drive):
            name, found = f"levels of {signal.channel}", _stated(signal, drive.duration_s)
            if found is not None:
                made[name] = _closer(made.get(name, found), found)
    return with_entries(model, made)


def _stated(signal: Numbers, duration_s: float) -> Leaves | None:
    levels, x = levels_of(signal.values), np.abs(signal.values)
    gaps = np.diff(levels)
    if len(gaps) < LEAST_GAPS:
        return None
    # Without a grid, how near levels lie is a matter of how many there are.
    sure = OFF_STEP if step_of(levels) else 1.0
    top = float(x.max())
    # What never stops may say 0 up to any speed.
    least = float(x[x > 0.0].min()) if (x == 0.0).any() and top > 0.0 else top
    quantiles = np.quantile(gaps, GAP_QUANTILES, method="lower")
    return Leaves(len(gaps), duration_s, (short(least), short(top)), six(quantiles),
                  six(sure * quantiles))  # fmt: skip


def _closer(a: Leaves, b: Leaves) -> Leaves:
    """The one of two whose levels lie closer, with the least speed of both."""
    chosen = a if a.rms[0] <= b.rms[0] else b
    low = min(a.speeds_mps[0], b.speeds_mps[0])
    return msgspec.structs.replace(chosen, speeds_mps=(low, max(low, chosen.speeds_mps[1])))
