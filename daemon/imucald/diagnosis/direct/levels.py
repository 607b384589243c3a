"""Evidence from a signal's values alone: the levels of its converter.

The levels of a converter are one step apart. If a later drive has coarser steps than the drives of
the model file, or is 0 up to a higher value, there is a new device or setting between sensor and
log. If a signal jumps over a range of values repeatedly and never shows a value in it, the range is
missing. An extended model file contains the levels of its own drives.
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
from imucald.diagnosis.fit.chance import Answer
from imucald.diagnosis.signals import SIGNALS, Channel, DriveSignals, Mask
from imucald.model.leaves import GAP_QUANTILES, Leaves
from imucald.model.model import VehicleModel

OF_WHEELS = ("speed", "wheel_speeds")
"""Signals that are 0 below some speed."""
NEAR_STEPS, OFF_STEP, ON_STEPS = 5.5, 0.1, 0.9
"""Conditions for the levels of a converter. At least the share ON_STEPS of the gaps of up to
NEAR_STEPS steps must be whole numbers of steps, within OFF_STEP. With random gaps, this share is a
fifth."""
LEAST_GAPS = 10
SAME = 1e-9
"""Distance of two levels, relative to the signal's largest value, below which the two levels are
one level with different rounding."""
GAIN = 1.0 + max(row.plausible[1] for key, row in PARAMETERS.items() if ".scale" in key)
"""Largest factor by which a plausible gain error may change a step."""
OBD_STEP = 1.0 / 3.6
"""One bit of a vehicle's speed [m/s] (SAE J1979, PID 0x0D)."""
FEW_CHANGES = 0.25
"""Quantile of the signal's changes. A hole must be wider than this quantile, because noise alone
may cause smaller changes."""


@dataclass(frozen=True)
class Numbers:
    """One component of a signal over time."""

    name: str
    """Name as in the reported structures: `accel_x`, `speed`."""
    channel: str
    unit: str
    t: Array
    values: Array
    """Values (N,) in the unit of the channel."""
    is_next: Mask
    """Flags (N - 1,): True if the following row is the next sent row."""


def signals_of(drive: DriveSignals) -> Iterator[Numbers]:
    """Yield each component of each signal of a drive, without samples that faults make invalid."""
    for name in SIGNALS:
        if drive.has(name):
            yield from numbers_of(name, drive.channels[name])


def numbers_of(name: str, channel: Channel) -> Iterator[Numbers]:
    """Yield each component of a signal."""
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
    """Return the levels (L,) that occur, in ascending order."""
    found = np.unique(x)
    apart = np.diff(found) > SAME * max(1.0, float(np.abs(found).max()))
    return np.asarray(found[np.concatenate([[True], apart])])


def step_of(levels: Array) -> float:
    """Return the step of the converter that made these levels: the gap that nine tenths of the gaps
    reach or exceed. 0 if there are few gaps, or if the levels are not on a common grid."""
    gaps = np.diff(levels)
    if len(gaps) < LEAST_GAPS:
        return 0.0
    step = float(np.quantile(gaps, GAP_QUANTILES[0], method="lower"))
    near = gaps[gaps < NEAR_STEPS * step] / step
    whole = np.abs(near - np.round(near)) <= OFF_STEP
    return step if len(near) >= LEAST_GAPS and whole.mean() >= ON_STEPS else 0.0


# against the file --------------------------------------------------------------------------------


def coarser(signal: Numbers, stated: VehicleModel) -> Iterator[Answer]:
    """Test one signal for coarser steps than in the drives of the model file.

    At most a tenth of the gaps between occurring levels are narrower than the new step. If the same
    number of levels were on the finer grid of the model file, far more gaps would be narrower."""
    file = stated.leaves.get(f"levels of {signal.channel}")
    if file is None or file.rms[0] == 0.0:
        return
    levels, lsb = levels_of(signal.values), file.rms[0]
    step, least = step_of(levels), GAIN * (lsb + file.spread[0])
    if step <= least:
        return
    ratio = step / lsb
    gaps = np.diff(levels)
    # One in `ratio` of the file's levels occurs; this is the chance that another one comes within a
    # step.
    narrow = 1.0 - (1.0 - 1.0 / ratio) ** (np.ceil(ratio - OFF_STEP) - 1.0)
    fewer = int((gaps < (1.0 - OFF_STEP) * step).sum())
    p = float(binom.cdf(fewer, len(gaps), narrow))
    text = (
        f"its values come in steps of {step:.3g} {signal.unit}, {ratio:.2g} times as large as "
        f"in the drives of the model file ({lsb:.3g}). The model file does not contain the "
        f"rounding error of {step / 12**0.5:.2g} {signal.unit}"
    )
    yield Answer(signal.name, step, least, p, text, shown=ratio)


def dead_band(signal: Numbers, stated: VehicleModel) -> Iterator[Answer]:
    """Test one speed for a range next to 0 that it never shows, but shows in the drives of the
    model file.

    The test uses the values next to 0, each time that the signal leaves or reaches 0. For uniformly
    distributed values, the chance that n values are between the smallest value and twice the
    smallest value is 2^-n. The chance does not depend on the rate (first event of a Poisson
    process: the integral of e^-u P(N >= n | u))."""
    file = stated.leaves.get(f"levels of {signal.channel}")
    if file is None or signal.channel not in OF_WHEELS:
        return
    x, dead = np.abs(signal.values), file.speeds_mps[0]
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
    limit, shown = max(2.0 * dead, dead + OBD_STEP), least / max(dead, 1e-3)
    yield Answer(signal.name, least, limit, 0.5**many, text, shown=shown)


# without a file ----------------------------------------------------------------------------------


def hole(signal: Numbers, _: VehicleModel) -> Iterator[Answer]:
    """Test a hole: a range of values that the signal jumps over again and again but never shows.

    Of all such ranges the one with the most jumps is tested. Without a fault each of these jumps
    has a chance of at most a half: it begins at most one width of the range below (or above) the
    range, and the smaller change that ends inside the range is at least as likely as the larger
    change across it. A standing vehicle that starts to move is an exception, so speeds are tested
    above 1 km/h only."""
    levels = levels_of(signal.values)
    step = step_of(levels)
    if step == 0.0:
        return
    # Readings that were rotated after rounding form clusters: their gaps are equal, but do not add
    # up to one grid from end to end.
    code = np.cumsum(np.round(np.diff(levels, prepend=levels[0]) / step))
    slope, start = np.polyfit(code, levels, 1)
    if (np.abs(levels - start - slope * code) <= OFF_STEP * step).mean() < ON_STEPS:
        return
    x = signal.values
    low = np.minimum(x[1:], x[:-1])[signal.is_next]
    high = np.maximum(x[1:], x[:-1])[signal.is_next]
    changes = (high - low)[high - low > 0.5 * step]
    if not len(changes):
        return
    # A signal that is rounded twice misses codes over its whole range, and any converter may have
    # single missing codes.
    twice = 2.5 * max(step, float(np.median(np.diff(levels))))
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
    yield Answer(signal.name, best[1] - best[0], least, p, text, shown=float(jumps))


# writing -----------------------------------------------------------------------------------------


def with_levels(model: VehicleModel, drives: Sequence[DriveSignals]) -> VehicleModel:
    """Return the model file with the levels of these drives' signals. For each signal, these are
    the finest levels of all drives, and the smallest value above 0."""
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
    # Without a grid, the gaps depend on the number of samples.
    sure = OFF_STEP if step_of(levels) else 1.0
    top = float(x.max())
    # A drive without a stop does not show up to which speed the signal says 0.
    least = float(x[x > 0.0].min()) if (x == 0.0).any() and top > 0.0 else top
    quantiles = np.quantile(gaps, GAP_QUANTILES, method="lower")
    return Leaves(len(gaps), duration_s, (short(least), short(top)), six(quantiles),
                  six(sure * quantiles))  # fmt: skip


def _closer(a: Leaves, b: Leaves) -> Leaves:
    """Return the entry with the finer levels, and with the smaller of the two smallest values."""
    chosen = a if a.rms[0] <= b.rms[0] else b
    low = min(a.speeds_mps[0], b.speeds_mps[0])
    return msgspec.structs.replace(chosen, speeds_mps=(low, max(low, chosen.speeds_mps[1])))
