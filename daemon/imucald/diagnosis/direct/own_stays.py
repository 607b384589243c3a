"""Test whether a signal stays at one value longer than it normally does.

A stay is a run of equal values. At constant speed, a signal stays at a value longer than in town,
so the lengths of its stays have a heavier tail than a geometric distribution. The model of a stay
therefore has a probability of going on that is drawn from a beta distribution, once for each stay.
The lengths then have a beta-geometric distribution (Waring's distribution; Weinberg and Gladen
1986) with a tail n^-b. The distribution is nearly geometric if the log shows no heavier tail.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaln
from scipy.stats import chi2

from imucald.core.arrays import Array

Steps = NDArray[np.intp]
FEW_STAYS = 20
"""Smallest number of stays for which the tail is also estimated from the longest stays."""
LONGEST = 0.1
"""Share of the longest stays for a separate estimate of the tail (peaks over a threshold, Pickands
1975)."""
_GRID = (np.arange(40) + 0.5) / 40.0
_GOES_ON, _ONE_OVER_B = np.meshgrid(_GRID, _GRID, indexing="ij")
_B = 1.0 / _ONE_OVER_B
"""Values of b. b is above 1, so that the mean length of a stay is finite. The prior is uniform in
1/b and in the mean probability a/(a + b)."""
_A = _GOES_ON / (1.0 - _GOES_ON) * _B


def number_as_long(own: Steps, length: int) -> float:
    """Return the expected number of a drive's stays that last at least this long. The result is the
    larger of two estimates: one from all stays, the other from the longest stays.

    own: (M,) lengths [steps, >= 1] of all stays of this drive except the tested stay. length:
    length of the tested stay [steps]. Without other stays the result is 1, because a filter that
    settles for the first time may stay for any time.
    """
    if not len(own):
        return 1.0
    ends = [1]
    if len(own) > FEW_STAYS:
        ends.append(int(np.sort(own)[-max(FEW_STAYS, round(LONGEST * len(own)))]))
    return max(_beyond(own[own >= end] - end, max(length - end, 0)) for end in ends)


def _beyond(more: Steps, length: int) -> float:
    """Return the expected number as in `number_as_long`, for the part of the stays beyond a
    threshold, from the posterior of a and b.

    P(L >= n) = B(a + n, b)/B(a, b), P(L = n) = B(a + n, b + 1)/B(a, b).
    """
    logs = np.zeros_like(_A)
    for n, count in zip(*np.unique(more, return_counts=True), strict=True):
        logs += count * (betaln(_A + n, _B + 1.0) - betaln(_A, _B))
    weights = np.exp(logs - logs.max())
    tail = np.exp(betaln(_A + length, _B) - betaln(_A, _B))
    return float(np.average(tail, weights=weights)) * (len(more) + 1)


def chance_of_change(own: Array, change: float) -> float:
    """Return the chance of a change at least as large as the change that ends a stay, by its rank.
    own: (M,) other changes."""
    return float((1 + (own >= change).sum()) / (len(own) + 1))


def chance_of_any(product: float, count: int, asked: int) -> float:
    """Return the chance that any of the tested stays has such a small product of the expected
    number and the other chances.

    count: number of factors. The first factor is `asked` times the chance of the stay's length. The
    chances are combined as independent chances (Fisher 1925) and corrected for the number of tested
    stays.
    """
    logs = -2.0 * np.log(max(product / asked, 1e-300))
    return min(1.0, asked * float(chi2.sf(logs, 2 * count)))
