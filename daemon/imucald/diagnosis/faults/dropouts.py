"""Drop-outs: frames of one signal that are missing in bursts, or far too often."""

from __future__ import annotations

import math

import numpy as np

from imucald.core.samples import Samples
from imucald.diagnosis.faults.cycle import Cycle
from imucald.diagnosis.faults.fault import (
    ACCEPT,
    PRIOR,
    WATCHED,
    Fault,
    Mask,
    joined,
    odds,
)
from imucald.diagnosis.result import Estimated
from imucald.model.model import VehicleModel

USUAL_LOSS = 3e-4
"""Frames that a sound bus or logger may lose one at a time."""
TOLERANCE = 5.0
"""The model file's loss may be wrong by this factor."""
LEAST_SHARE = 0.001
"""A few holes in a drive are nothing to name: rows around them are left out anyway."""
LONGEST_LOG = 2000.0
"""Bursts are as likely short as long (evenly in the logarithm), up to this many frames."""
WITNESS_FRAMES = 3
"""So many frames of another signal should come in a hole for it to tell anything."""


def find(samples: Samples, model: VehicleModel, cycles: dict[str, Cycle]) -> list[Fault]:
    """Return the channels that lose frames beyond chance."""
    found = [_channel(name, samples, model, cycles) for name in cycles]
    return [fault for fault in found if fault is not None]


def _channel(
    name: str, samples: Samples, model: VehicleModel, cycles: dict[str, Cycle]
) -> Fault | None:
    cycle, t = cycles[name], samples[name].t
    if not cycle.lost.any():
        return None
    at = np.flatnonzero(cycle.lost)
    at = at[~_silent(t[at], t[at + 1], name, samples, cycles)]
    lost = cycle.lost[at]
    frames = cycle.frames
    share = float(lost.sum()) / frames
    allowed = max(TOLERANCE * getattr(model, name).loss, USUAL_LOSS)
    if share < max(LEAST_SHARE, allowed):
        return None
    many = lost >= 2
    singles = int(np.sum(~many))
    score = PRIOR - math.log(len(WATCHED)) + _bursts(lost[many], singles, frames, allowed)
    score += _too_many(singles, frames, allowed)
    if score < ACCEPT:
        return None
    stretches = [(float(t[i]), float(t[i + 1])) for i in at[many]]
    counted = math.sqrt(1.0 + 0.25 * len(at)) / frames
    longest = float(np.max(t[at + 1] - t[at]))
    text = (
        f"{name} lost {lost.sum()} of {frames} frames ({100.0 * share:.2g} %) in {len(at)} holes, "
        f"{len(stretches)} of them of several frames, the longest {longest:.2g} s, "
        f"from {t[at[0]]:.0f} s to {t[at[-1]]:.0f} s."
    )
    parameters = {
        f"{name}.loss": Estimated(share, counted, "share"),
        f"{name}.single_loss": Estimated(
            singles / frames, math.sqrt(singles + 1.0) / frames, "share"
        ),
        f"{name}.bursts": Estimated(float(len(stretches)), 0.5, "count"),
    }
    return Fault("dropouts", name, parameters, score, joined(stretches), text)


def _silent(
    first: np.ndarray[tuple[int], np.dtype[np.float64]],
    last: np.ndarray[tuple[int], np.dtype[np.float64]],
    name: str,
    samples: Samples,
    cycles: dict[str, Cycle],
) -> Mask:
    """Holes in which nothing at all came: the log's, not the signal's."""
    heard = np.zeros(len(first), dtype=bool)
    asked = np.zeros(len(first), dtype=bool)
    for other, cycle in cycles.items():
        if other == name:
            continue
        t = samples[other].t
        margin = cycles[name].period_s + cycle.period_s
        asked |= last - first > 2.0 * margin + WITNESS_FRAMES * cycle.period_s
        heard |= np.searchsorted(t, last - margin) > np.searchsorted(t, first + margin)
    return np.asarray(asked & ~heard)


def _bursts(
    lost: np.ndarray[tuple[int], np.dtype[np.int64]], singles: int, frames: int, allowed: float
) -> float:
    """Log Bayes factor of losses in bursts against frames lost one by one, at random."""
    if not len(lost):
        return 0.0
    alone = max((singles + 1.0) / frames, allowed)
    rate = len(lost) / frames
    as_bursts = math.log(rate) - np.log(lost * math.log(LONGEST_LOG))
    # Their rate was fitted: it costs what a number known to 1/sqrt(count) of a decade costs.
    return float(np.sum(as_bursts - lost * math.log(alone))) - math.log(frames) / 2.0


def _too_many(singles: int, frames: int, allowed: float) -> float:
    """Log odds that single losses are more than the bus may lose (Chernoff's bound)."""
    rate = singles / frames
    if rate <= allowed:
        return 0.0
    exponent = rate * math.log(rate / allowed) + (1 - rate) * math.log((1 - rate) / (1 - allowed))
    return odds(-frames * exponent)
