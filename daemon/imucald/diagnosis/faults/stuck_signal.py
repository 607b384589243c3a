"""Stuck signals: values that stand still while the rest says that they should change.

How often a signal changes is learnt from the drive itself, for each kind of moment that the other
signals tell apart: standing, rolling, turning. A stretch of equal values is weighed by the changes
that were due in it. With the right rates this number is spread as exp(-x) whatever the signal's
step and noise are (a signal with a coarse step has few changes due, a parked car's speed none); how
far its tail really reaches is read off the drive's own stretches.
"""

from __future__ import annotations

import math

import numpy as np

from imucald.core.samples import Samples, Series
from imucald.diagnosis.faults import saturation
from imucald.diagnosis.faults.activity import resting, situations
from imucald.diagnosis.faults.fault import (
    ACCEPT,
    PRIOR,
    WATCHED,
    Array,
    Fault,
    Index,
    Mask,
    joined,
    odds,
    repeats,
    runs,
    watched,
)
from imucald.diagnosis.result import Estimated
from imucald.model.model import VehicleModel

SHORTEST_S = 2.0
"""Shorter stretches do no harm."""
FEWEST_FRAMES = 5
SURE = 0.98
"""No signal's change is held more certain than this at any one frame."""
FARTHEST, FELLOWS = 0.002, 60
"""The tail of chance is read off where this share of the stretches is longer, or so many of them:
more than stretches that are stuck."""
BROADER = 4.0
"""And where this many times as many are."""
HEAVIEST = 0.35
"""Exponent of the heaviest tail that is believed, exp(-x^0.35)."""
MANY, LIGHTEST = 10_000, 0.6
"""With fewer stretches than this their tail is known so little that no lighter one is believed."""
CLEAR = 9.0
"""-log of the chance of one stretch in the whole drive, from which on it is stuck."""
FELLOW = 3.0
"""Log odds for further stretches of a signal that is known to stick,"""
ALIKE = 0.2
"""if they are not far shorter than those that are clear."""


def find(samples: Samples, model: VehicleModel, railed: frozenset[str]) -> list[Fault]:
    """Return the channels that stood still. railed: channels that are known to saturate."""
    found: list[Fault] = []
    suspects, known = watched(samples), dict(samples)
    while suspects:
        tried = [_channel(name, known, model, name in railed) for name in suspects]
        faults = sorted((f for f in tried if f is not None), key=lambda fault: -fault.score)
        if not faults:
            break
        found.append(faults[0])
        # The others may only seem stuck beside the one that is: they are tried without it.
        known[faults[0].signal] = _without(samples[faults[0].signal], faults[0])
        suspects = [fault.signal for fault in faults[1:]]
    return found


def _without(series: Series, fault: Fault) -> Series:
    """The samples that are not stuck."""
    keep = np.ones(len(series.t), dtype=bool)
    for start, stop in fault.spoilt:
        keep[np.searchsorted(series.t, start) : np.searchsorted(series.t, stop, "right")] = False
    return Series(series.t[keep], series.values[keep])


def _channel(name: str, samples: Samples, model: VehicleModel, railed: bool) -> Fault | None:
    series = samples[name]
    same = repeats(series.values)
    first, last = runs(same)
    if not len(first):
        return None
    long_enough = (series.t[last] - series.t[first] >= SHORTEST_S) & (last - first >= FEWEST_FRAMES)
    if not long_enough.any():
        return None
    rest = _at_zero(name, samples)
    due = _due(situations(name, samples, model)[1:], same, rest[1:], first, last)
    count = max(int(np.count_nonzero(~same)), 1)
    surprise = _surprise(due, count)
    fits = long_enough & ~_at_rail(series, first, railed)
    stuck = fits & (surprise - math.log(count) > CLEAR)
    clear = int(np.count_nonzero(stuck))
    if not clear:
        return None
    score = PRIOR - math.log(len(WATCHED))
    score += sum(odds(-float(x)) for x in surprise[stuck] - math.log(count))
    length = series.t[last] - series.t[first]
    alike = length > ALIKE * float(np.median(length[stuck]))
    stuck |= fits & alike & (surprise - math.log(count / clear) > FELLOW)
    if score < ACCEPT:
        return None
    usual = (last - first)[~long_enough & ~rest[first + 1]].astype(np.float64)
    # What a stretch is longer by, because the value happened to stay before it stuck.
    more = float(np.sum(usual**2)) / max(2.0 * (float(np.sum(usual)) + count), 1.0)
    return _fault(name, series, first[stuck], last[stuck], rest, more, score)


def _fault(
    name: str, series: Series, first: Index, last: Index, rest: Mask, more: float, score: float
) -> Fault:
    t, frames = series.t, len(series.t)
    # A speed stuck at 0 may have been so since any moment of the stop before.
    resting = np.concatenate(([0], np.cumsum(rest)))
    still = resting[last + 1] - resting[first + 1]
    known = last - first - still
    unknown = np.minimum(still, np.maximum(known, known.max()))
    share = float(np.sum(known + 0.5 * unknown - more)) / frames
    ends = 2.0 + (2.0 + 2.0 * more) ** 2 * len(first)
    # Whole stretches may hide in stops.
    blind = float(np.mean(rest))
    hidden = len(first) * blind / max(1.0 - blind, 0.1) * float(np.mean(known**2))
    std = math.sqrt(ends + float(np.sum(unknown**2)) / 12.0 + hidden) / frames
    stretches = [(float(t[i]), float(t[j])) for i, j in zip(first, last, strict=True)]
    longest = max(stop - start for start, stop in stretches)
    parameters = {
        f"{name}.stuck_share": Estimated(share, std, "share"),
        f"{name}.stuck_stretches": Estimated(float(len(first)), 0.5, "count"),
    }
    text = (
        f"{name} stood still {len(first)} times while the other signals say that it should have "
        f"changed, {100.0 * share:.2g} % of the time, the longest for {longest:.1f} s, "
        f"from {stretches[0][0]:.0f} s to {stretches[-1][1]:.0f} s."
    )
    return Fault("stuck_signal", name, parameters, score, joined(stretches), text)


def _at_zero(name: str, samples: Samples) -> Mask:
    """(N,) where the signal is 0 and may be."""
    values = samples[name].values
    zero = values == 0.0 if values.ndim == 1 else np.all(values == 0.0, axis=1)
    return np.asarray(resting(name, samples) & zero)


def _due(kind: Index, same: Mask, rest: Mask, first: Index, last: Index) -> Array:
    """Changes due in each stretch of equal values, in nats of log probability.

    kind, same, rest: (N-1,), of each sample and the one before it.
    """
    active = ~rest
    frames = np.bincount(kind, active)
    changed = np.bincount(kind, active & ~same, minlength=len(frames))
    rate = np.minimum((changed + 0.5) / (frames + 1.0), SURE)
    nats = -np.log1p(-rate)
    total = np.concatenate(([0.0], np.cumsum(np.where(active, nats[kind], 0.0))))
    result: Array = total[last] - total[first]
    return result


def _surprise(due: Array, count: int) -> Array:
    """-log of the probability of stretches at least as improbable, per stretch.

    count: stretches in all, those of one sample included.
    """
    share = min(max(FARTHEST, FELLOWS / count), 0.2)
    near, far = -math.log(min(BROADER * share, 0.9)), -math.log(share)
    inner, outer = (_quantile(due, count, math.exp(-x)) for x in (near, far))
    outer = max(outer, far)
    inner = min(max(inner, near), outer * (1.0 - 1e-9))
    # A tail exp(-(x/scale)^k) through both.
    k = math.log(far / near) / math.log(outer / inner)
    k = min(max(k, HEAVIEST), 1.0 if count > MANY else LIGHTEST)
    result: Array = far * (due / outer) ** k
    return result


def _quantile(due: Array, count: int, share: float) -> float:
    """Value that this share of all stretches exceeds; those of one sample have 0."""
    above = int(share * count)
    if above >= len(due):
        return 0.0
    return float(np.partition(due, len(due) - 1 - above)[len(due) - 1 - above])


def _at_rail(
    series: Series, first: Index, railed: bool
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Stretches on the rail of a channel that saturates."""
    if not railed:
        return np.zeros(len(first), dtype=bool)
    return saturation.on_rail(series)[1][first]
