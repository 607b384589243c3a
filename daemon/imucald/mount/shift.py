"""Has the sensor moved? New evidence against what was known before it.

Evidence comes in pieces of road of about 26 s of driving. For every angle and for the last 2, 3,
... 12 pieces, a change of the angle that begins with them is fitted beside the angle and the
nuisance of all pieces (a generalised likelihood ratio test for a step of unknown time and size;
Basseville and Nikiforov, Detection of Abrupt Changes, 1993, ch. 2.4). The spread from piece to
piece before sets the scale, so that rough roads and hills make the test dull and not nervous.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SPANS = (2, 3, 4, 6, 8, 10, 12)
"""Pieces of road that are held against all before."""
LEAST_BEFORE = (16, 10, 16)
"""Pieces that must have been before, for roll, pitch and yaw."""
CLIP = 4.5
"""No single piece counts for more standard deviations: one bad road moves no sensor."""
UNEVEN_STD = (0.0045, 0.0026, 0.0015)
"""Town and motorway differ by that much [rad] without a shift."""
THRESHOLD = (
    (6.1, 6.0, 5.8, 5.7, 5.1, 4.9, 4.9),
    (6.0, 6.5, 6.5, 5.5, 5.1, 5.0, 5.0),
    (4.3, 4.3, 4.2, 3.8, 3.5, 3.3, 3.3),
)
"""For roll, pitch and yaw, and each span, in standard deviations; docs/mount-accuracy.md: what
they give. Over short spans a stretch of leaning road or a windy one passes for a turn."""
OTHER_ROADS = 1.15
"""Thresholds are so much higher where it takes pieces of earlier drives to test at all."""
LEAST_KNOWN = 1e-6
"""New pieces that know less of the angle than this share say nothing."""
HINTED = 0.7
"""Share of the threshold where a step in gravity hints at the same."""
PRIOR_PIECES, PRIOR_SPREAD, LEAST_SPREAD = 6.0, 1.0, 0.8
"""The spread before is taken as the model's with that weight, and as no less than that share."""


@dataclass(frozen=True)
class Fit:
    """The fit of an angle together with its source's nuisance, piece by piece.

    left (G,): scores of the angle that the fit leaves over. rows (G, 1 + k): information of the
    angle, and what it shares with the nuisance. inverse (1 + k, 1 + k): covariance of both, from
    all pieces and priors. value: the angle [rad].
    """

    left: Array
    rows: Array
    inverse: Array
    value: float


@dataclass(frozen=True)
class Flow:
    """Evidence about one angle from one source, piece by piece: scores and informations (G,).

    fit: where the angle was fitted together with nuisance; else each piece speaks of it alone.
    """

    axis: int
    score: Array
    information: Array
    fit: Fit | None = None

    def behind(self, score: Array, information: Array) -> Flow:
        """This flow behind earlier pieces (E,), which speak of the angle alone."""
        both = np.concatenate([score, self.score]), np.concatenate([information, self.information])
        fit = self.fit
        if fit is None:
            return Flow(self.axis, *both)
        known = float(information.sum())
        column = fit.inverse[:, 0]
        inverse = fit.inverse - np.outer(column, column) * (known / (1.0 + known * column[0]))
        moved = inverse[:, 0] * (float(score.sum()) - known * fit.value)
        value = fit.value + float(moved[0])
        left = np.concatenate([score - information * value, fit.left - fit.rows @ moved])
        rows = np.zeros((len(left), fit.rows.shape[1]))
        rows[: len(score), 0] = information
        rows[len(score) :] = fit.rows
        return Flow(self.axis, *both, Fit(left, rows, inverse, value))

    def fitted(self) -> Fit | None:
        """The fit; without nuisance the mean. None without any information."""
        if self.fit is not None:
            return self.fit
        n, total = self.information, float(self.information.sum())
        if total <= 0.0:
            return None
        mean = float(self.score.sum()) / total
        return Fit(self.score - n * mean, n[:, None], np.array([[1.0 / total]]), mean)


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
        longest = n - LEAST_BEFORE[axis] if fresh is None else min(n - LEAST_BEFORE[axis], fresh)
        spans = [span for span in SPANS if span <= longest]
        if not spans:
            continue
        sizes, deviations_of = changes(mine, np.array(spans), axis)
        for k, span in enumerate(spans):
            size, deviations = float(sizes[k]), float(deviations_of[k])
            threshold = THRESHOLD[axis][k]
            if hint is not None and hint[0] == axis and hint[1] * size > 0.0:
                threshold *= HINTED
            if fresh is not None and fresh - span < LEAST_BEFORE[axis]:
                threshold *= OTHER_ROADS
            excess = abs(deviations) / threshold
            if best is None or excess > best.excess:
                best = Shift(axis, size, deviations, span, excess)
    return best


def changes(flows: list[Flow], spans: NDArray[np.int64], axis: int) -> tuple[Array, Array]:
    """Change of an angle over its last spans (S,): size [rad] (S,), in standard deviations (S,).

    Each source fits its own level before, its own nuisance and its own change; the changes are
    then averaged.
    """
    precision, weighted = np.zeros(len(spans)), np.zeros(len(spans))
    for flow in flows:
        if len(flow.score) > spans[0]:
            size, known = _change(flow, np.minimum(spans, len(flow.score) - 1))
            precision += known
            weighted += known * size
    good = precision > 0.0
    size = np.where(good, weighted / np.where(good, precision, 1.0), 0.0)
    variance = 1.0 / np.where(good, precision, 1e-9) + UNEVEN_STD[axis] ** 2
    return size, size / np.sqrt(variance)


def _change(flow: Flow, spans: NDArray[np.int64]) -> tuple[Array, Array]:
    """Change of one source over its last spans (S,): size [rad] and information (S,).

    With M the information of angle and nuisance from all pieces, w what the new pieces have of
    its first row and U their scores left over by the common fit, the change is U / V with
    V = w_0 - w' M^-1 w (the score test of a linear model; exact). So what new pieces know of the
    angle only together with nuisance that they alone show, counts for nothing.
    """
    fit = flow.fitted()
    if fit is None:
        return np.zeros(len(spans)), np.zeros(len(spans))
    left, rows, inverse = fit.left, fit.rows, fit.inverse
    n = rows[:, 0]
    first = len(n) - spans
    w = np.cumsum(rows[::-1], axis=0)[spans - 1]
    turned = w @ inverse
    known = w[:, 0] - (turned * w).sum(axis=1)
    use = known > LEAST_KNOWN * float(n.sum())
    size = np.where(use, np.cumsum(left[::-1])[spans - 1] / np.where(use, known, 1.0), 0.0)
    old = np.arange(len(n)) < first[:, None]
    alone = left + size[:, None] * (turned @ rows.T)  # against the fit to the old ones
    expected = np.maximum(n - ((rows @ inverse) * rows).sum(axis=1), 0.0)
    ratio = (old * alone * alone).sum(axis=1) / np.maximum(old @ expected, 1e-12)
    pieces = (old @ n) ** 2 / np.maximum(old @ (n * n), 1e-12)
    scale = (PRIOR_PIECES * PRIOR_SPREAD + pieces * np.maximum(ratio, LEAST_SPREAD)) / (
        PRIOR_PIECES + pieces
    )
    limit = CLIP * np.sqrt(scale[:, None] * n)
    clipped = (~old * np.clip(alone, -limit, limit)).sum(axis=1)
    size = np.where(use, clipped / np.maximum(w[:, 0], 1e-12), 0.0)
    return size, np.where(use, known / scale, 0.0)
