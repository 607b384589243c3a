"""Has the sensor moved? New evidence against what was known before it.

Evidence comes in pieces of road of about 26 s of driving. For every angle and for the last 1, 2,
3, ... 12 pieces, their mean is tested against the mean of all pieces before (a generalised
likelihood ratio test for a step of unknown time and size; Basseville and Nikiforov, Detection of
Abrupt Changes, 1993, ch. 2.4). The spread from piece to piece before sets the scale, so that rough
roads and hills make the test dull and not nervous.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SPANS = (2, 3, 4, 6, 8, 12)
"""Pieces of road that are held against all before."""
LEAST_BEFORE = (16, 10, 10)
"""Pieces that must have been before, for roll, pitch and yaw."""
CLIP = 4.5
"""No single piece counts for more standard deviations: one bad road moves no sensor."""
UNEVEN_STD = (0.0045, 0.0026, 0.0015)
"""Town and motorway differ by that much [rad] without a shift."""
SHORT_SPAN = 6
"""Below, a stretch of leaning road or a windy one passes for a turn of the sensor."""
THRESHOLD = (5.3, 5.4, 3.9)
"""For roll, pitch and yaw, in standard deviations; docs/mount-accuracy.md: what they give."""
THRESHOLD_SHORT = (6.6, 6.0, 4.8)
"""The same for spans below `SHORT_SPAN`."""
HINTED = 0.7
"""Share of the threshold where a step in gravity hints at the same."""
PRIOR_PIECES, PRIOR_SPREAD, LEAST_SPREAD = 6.0, 1.0, 0.3
"""The spread before is taken as the model's with that weight, and as no less than that share."""


@dataclass(frozen=True)
class Flow:
    """Evidence about one angle from one source, piece by piece: scores and informations (G,)."""

    axis: int
    score: Array
    information: Array


@dataclass(frozen=True)
class Shift:
    """The largest change found: axis, size [rad], in standard deviations, pieces ago.

    excess: standard deviations over their threshold; a shift from 1 on.
    """

    axis: int
    size: float
    deviations: float
    pieces: int
    excess: float


def largest_change(
    flows: list[Flow],
    axes: tuple[int, ...] = (0, 1, 2),
    hint: tuple[int, float, int] | None = None,
    fresh: int | None = None,
) -> Shift | None:
    """Return the change of an angle that stands out most; None where too little is known.

    hint: axis, sign and age of a step that gravity hints at; it lowers the threshold for it.
    fresh: pieces of this drive, where flows begin with those of earlier ones; no span is longer.
    """
    best: Shift | None = None
    for axis in axes:
        mine = [flow for flow in flows if flow.axis == axis]
        if not mine:
            continue
        n = max(len(flow.score) for flow in mine)
        for span in SPANS:
            if n - span < LEAST_BEFORE[axis] or (fresh is not None and span > fresh):
                break
            found = _change(mine, span, axis)
            if found is None:
                continue
            size, deviations = found
            threshold = (THRESHOLD_SHORT if span < SHORT_SPAN else THRESHOLD)[axis]
            if hint is not None and hint[0] == axis and hint[1] * size > 0.0:
                threshold *= HINTED
            excess = abs(deviations) / threshold
            if best is None or excess > best.excess:
                best = Shift(axis, size, deviations, span, excess)
    return best


def _change(flows: list[Flow], span: int, axis: int) -> tuple[float, float] | None:
    score_old = info_old = score_new = info_new = 0.0
    for flow in flows:
        s, n = flow.score, flow.information
        if len(s) <= span:
            continue
        before, total = s[:-span], float(n[:-span].sum())
        if total <= 0.0:
            continue
        mean = float(before.sum()) / total
        left = before - n[:-span] * mean
        pieces = float(total**2 / max(float(n[:-span] @ n[:-span]), 1e-12))
        ratio = float((left * left).sum()) / total
        scale = (PRIOR_PIECES * PRIOR_SPREAD + pieces * max(ratio, LEAST_SPREAD)) / (
            PRIOR_PIECES + pieces
        )
        recent_n = n[-span:]
        limit = CLIP * np.sqrt(scale * recent_n)
        recent = np.clip(s[-span:] - recent_n * mean, -limit, limit)
        score_new += float((recent + recent_n * mean).sum()) / scale
        info_new += float(recent_n.sum()) / scale
        score_old += float(before.sum()) / scale
        info_old += total / scale
    if info_old <= 0.0 or info_new <= 0.0:
        return None
    size = score_new / info_new - score_old / info_old
    variance = 1.0 / info_new + 1.0 / info_old + UNEVEN_STD[axis] ** 2
    return size, size / variance**0.5
