"""Whether a signal stays at one value for longer than it does by itself.

At a steady cruise a signal stays for longer than in town, so that its stays have a heavier tail
than a coin that is thrown at each sample. So each stay has its own probability of going on, drawn
from a beta law: lengths are then Waring's (beta-geometric; Weinberg and Gladen 1986), with a tail
n^-b, or as good as geometric where the log shows no more than that.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaln
from scipy.stats import chi2

from imucald.core.arrays import Array

Steps = NDArray[np.intp]
FEW_STAYS = 20
"""Of fewer the longest are no measure of a tail."""
LONGEST = 0.1
"""Share of the stays that shows the tail by itself (peaks over a threshold, Pickands 1975)."""
_GRID = (np.arange(40) + 0.5) / 40.0
_GOES_ON, _ONE_OVER_B = np.meshgrid(_GRID, _GRID, indexing="ij")
_B = 1.0 / _ONE_OVER_B
"""b over 1: a stay has a mean length. Even prior of 1/b and of the mean probability a/(a + b)."""
_A = _GOES_ON / (1.0 - _GOES_ON) * _B


def number_as_long(own: Steps, length: int) -> float:
    """How many of a drive's stays last so long, on an average: by all of them and by the longest,
    the larger of both.

    own: (M,) lengths of the others in steps, 1 or more; length: the same of the one in question. 1
    against none, since a filter that settles for the first time does so for as long as it may.
    """
    if not len(own):
        return 1.0
    ends = [1]
    if len(own) > FEW_STAYS:
        ends.append(int(np.sort(own)[-max(FEW_STAYS, round(LONGEST * len(own)))]))
    return max(_beyond(own[own >= end] - end, max(length - end, 0)) for end in ends)


def _beyond(more: Steps, length: int) -> float:
    """The same of stays less a threshold; by the posterior of a and b.

    P(L >= n) = B(a + n, b)/B(a, b), P(L = n) = B(a + n, b + 1)/B(a, b).
    """
    logs = np.zeros_like(_A)
    for n, count in zip(*np.unique(more, return_counts=True), strict=True):
        logs += count * (betaln(_A + n, _B + 1.0) - betaln(_A, _B))
    weights = np.exp(logs - logs.max())
    tail = np.exp(betaln(_A + length, _B) - betaln(_A, _B))
    return float(np.average(tail, weights=weights)) * (len(more) + 1)


def chance_of_change(own: Array, change: float) -> float:
    """Of a change as large as that at which a stay ends, by its rank. own: (M,) other changes."""
    return float((1 + (own >= change).sum()) / (len(own) + 1))


def chance_of_any(product: float, count: int, asked: int) -> float:
    """That any of so many stays has so small a product: number as long, times other chances.

    count: factors, with the first, which is `asked` times the chance of its length among those
    asked. Of independent chances (Fisher 1925), shared out over the stays asked.
    """
    logs = -2.0 * np.log(max(product / asked, 1e-300))
    return min(1.0, asked * float(chi2.sf(logs, 2 * count)))
