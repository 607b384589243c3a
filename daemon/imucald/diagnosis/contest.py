"""Rivals: explanations that only fits of their own can tell apart."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from imucald.diagnosis.bent import STARTS, hurdle
from imucald.diagnosis.causes import sensor_lowpass
from imucald.diagnosis.shifts import places
from imucald.diagnosis.trial import ACCEPT, Found, Trial

if TYPE_CHECKING:
    from imucald.diagnosis.search import Search

BENT_ALIKE = 25.0
"""Fits of rivals within this log evidence of the best are look-alikes: shapes are known less well
than sizes."""
FAMILIES = (
    frozenset({"signal_delay", "sensor_lowpass"}),
    frozenset({"mount_shift", "mount_rotation"}),
)
RIVAL_SHARE, MOST_RIVALS = 0.1, 4
"""Rivals have at least this share of the best one's score; so many are fitted."""


def rivals_of(trials: Sequence[Trial]) -> list[Trial]:
    """Distinct forms and places that only a fit of their own can tell apart.

    Delay and low-pass are the same to first order; so are turns of the mount at some time.
    """
    chosen: list[Trial] = []
    for trial in trials:
        known = [_place(t) for t in chosen]
        family = any(
            trial.variant.cause in f and chosen and chosen[0].variant.cause in f for f in FAMILIES
        )
        is_rival = not chosen or bool(trial.start) or family
        is_weak = bool(chosen) and trial.score < RIVAL_SHARE * chosen[0].score
        if is_rival and not is_weak and trial.score >= ACCEPT and _place(trial) not in known:
            chosen.append(trial)
    return chosen[:MOST_RIVALS]


def winner(search: Search, before: Found, rivals: Sequence[Found]) -> Found | None:
    """Compare fits at their own best points, each with the noise that it leaves.

    None where the best is not worth its place, although it seemed so from afar.
    """
    least = before.point.density(before.keys)
    said = [_gain(search, found, least) for found in rivals]
    worth = [
        score
        if min(score, search.loss(found, found.active[-1])) > hurdle(found.active)
        else -math.inf
        for found, score in zip(rivals, said, strict=True)
    ]
    if max(worth) == -math.inf:
        return None
    best = rivals[int(np.argmax(worth))]
    newest = best.active[-1]
    near = {
        found.active[-1].cause
        for found, score in zip(rivals, said, strict=True)
        if score > max(worth) - BENT_ALIKE
    }
    if len(near) > 1:
        best.alike = [*best.alike, (newest.cause, *sorted(near - {newest.cause}))]
    return best


def _gain(search: Search, found: Found, least: float) -> float:
    """Log odds of a rival's fit against what was before."""
    values = found.point.values
    if not all(sensor_lowpass.is_possible(f.track, values) for f in search.forwards):
        return -math.inf
    name = found.active[-1].cause
    gain = found.point.density(found.keys) + _prior_at(search, found) - least
    # A constant that is left looks like noise of the mean; near the point, what the linear score
    # says of it holds.
    return gain if name in STARTS else max(gain, found.scores[name])


def _prior_at(search: Search, found: Found) -> float:
    """Log prior odds of the newest cause; a shift may be at any of many times."""
    newest = found.active[-1]
    times = math.log(places(found)) if newest.cause == "mount_shift" else 0.0
    return search.prior(newest) - times


def _place(trial: Trial) -> tuple[str, str, tuple[float, ...]]:
    """Which form of which cause, begun where; a shift's many times are one place."""
    start = () if trial.variant.cause == "mount_shift" else tuple(trial.start.values())
    return trial.variant.cause, trial.variant.label, start
