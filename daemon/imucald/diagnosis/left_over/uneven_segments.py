"""Segments that leave more than others: of the drive itself, or of those of the model file.

What half of a drive's segments leave is no noise where most of the drive is bad. A model file may
state what its own drives left, and how far their segments differ.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import pairwise, product

import numpy as np
from scipy.special import betainc, ndtr, stdtr, stdtrit
from scipy.stats import beta, chi2
from scipy.stats import f as fisher

from imucald.core.arrays import Array
from imucald.diagnosis.fit.beside_file import LEAST_RMS, ROAD_CLASS, Left, beside_file, in_both
from imucald.diagnosis.fit.chance import Question
from imucald.diagnosis.fit.score import Hypothesis, Problem, one_in_fifteen, what_leaves
from imucald.diagnosis.result import LOUDER, UNEVEN, Structure
from imucald.model.leaves import BANDS_HZ, Leaves
from imucald.model.model import VehicleModel

EVEN = ("accel_x", "accel_y", "accel_z")
"""Equations in which nothing of the road is left, nor of the springs, where a gyroscope carries
gravity."""
CARRIED_BY = "gyro_x"
LEAST_BLOCKS = 4
"""Of fewer, half and the one that must not decide are not two groups."""
CHANCE = 0.01
"""That noise alone makes more than one segment in fifteen louder than what is taken for noise."""
OF_MEDIAN = 2.0 / np.pi
"""Variance of the mean over that of the median, of normal numbers."""
SHARES = {15: "one segment in fifteen leaves", 4: "one segment in four leaves",
          2: "half of the segments leave"}  # fmt: skip
FLAT = ("accel_x", "longitudinal_accel", "gyro_z", "yaw_rate", "speed")
"""Equations in which no road's unevenness stands."""
FAR = 6.0
LASTING = np.linspace(-FAR, FAR, 121)
"""Deviations by which all segments together may differ from the file's."""
WEIGHT = np.exp(-0.5 * LASTING**2) / np.exp(-0.5 * LASTING**2).sum()


def uneven(problem: Problem, drift: Hypothesis | None) -> list[Structure]:
    """Segments that leave more than their noise and than a correct file could: something acts in
    some of them that no parameter describes.

    Noise is what half of the segments leave, and how one segment scatters about their median
    (Fisher's F: of few segments the median is not known well), so far that more than one in fifteen
    are beyond it with a chance of 1 % (binomial). Beyond that a segment may leave what parameters
    off by their tolerances make in it. One segment in fifteen must not decide. drift: of what was
    named and has no place in the model file; it is fitted beside.
    """
    table, z = problem.table, what_leaves(problem, drift)
    found: list[Structure] = []
    if CARRIED_BY not in table.plain:
        return found  # each segment leaves its own road's slope
    for name in EVEN:
        there = table.by_equation[name][:, 0, 0] > 0.0 if name in table.plain else np.zeros(0, bool)
        if there.sum() < LEAST_BLOCKS:
            continue
        gram = table.plain[name][there].sum(axis=1)
        power = np.einsum("bi,bij,bj->b", z[there], gram, z[there])
        may = np.einsum("bjj,j->b", gram[:, 1:, 1:], table.tolerance**2)
        count = max(1, int(2.0 * table.seconds * table.top_hz[name]))
        middle = float(np.median(power)) * count / chi2.median(count)
        few, n = one_in_fifteen(len(power)), len(power)
        # So that of n segments more than `few` are beyond it with that chance (Clopper, Pearson).
        each = beta.ppf(CHANCE, few + 1, n - few)
        noise = middle * fisher.isf(each, count, OF_MEDIAN * count * n)
        over = np.sort((power - noise) / np.maximum(may, 1e-30))
        size = float(over[n - few - 1])
        if size > 1.0:
            text = (
                f"one segment in fifteen leaves {np.sqrt(size):.2g} times the residual of a "
                "correct file, not counting noise: something acts only in these segments"
            )
            found.append(Structure(name, UNEVEN, float(np.sqrt(size)), text))
    return found


def more_than_stated(left: Mapping[float, Left], stated: VehicleModel) -> list[Question]:
    """Whether one segment in fifteen, in four or in two leaves more of an equation in a band than
    the model file states of its own drives. Of segments at speeds of the file's. left: of
    `left_of`."""
    return [
        question
        for seconds, own in left.items()
        for name, rms, file in in_both(own, stated.leaves, seconds, LEAST_BLOCKS)
        for question in _of_equation(name, rms, file)
    ]


def _of_equation(name: str, rms: Array, file: Leaves) -> Iterator[Question]:
    """One question, of all bands but the last. rms: (B, bands) of each segment.

    Where the road shakes, a segment may exceed the file in all bands by as much as in the last: a
    rougher road is rougher in every band (ISO 8608: classes have one slope).
    """
    if name not in FLAT:
        rms = rms / np.maximum(rms[:, -1:] / max(file.rms[-1], LEAST_RMS), 1.0)
    logs, _, _, free = beside_file(rms, file)
    logs = logs - np.log(np.maximum(file.rms, LEAST_RMS))
    n, few, spread = len(logs), one_in_fifteen(len(logs)), np.asarray(file.spread)
    # So many neighbours count as one for a mean; for a spread fewer do (Bartlett 1946).
    one = np.broadcast_to((n + file.segments) / (free + 2.0), spread.shape)
    r2 = ((one - 1.0) / (one + 1.0)) ** 2
    known = np.maximum(file.segments * (1.0 - r2) / (1.0 + r2) - 1.0, 1.0)
    lasting = spread * np.sqrt(one * (1.0 / n + 1.0 / file.segments) / OF_MEDIAN)
    made = []
    counted = {max(few + 1, n // share): words for share, words in SHARES.items()}
    for (i, (low, high)), k in product(enumerate(pairwise(BANDS_HZ[:-1])), counted):
        x = float(np.sort(logs[:, i])[-k])
        # What as many of the file's own segments leave.
        own = max(float(spread[i] * stdtrit(known[i], 1.0 - k / (n + 1.0))), 0.0)
        text = (
            f"between {low:g} and {high:g} Hz {counted[k]} at least {np.exp(x):.2g} times the "
            "median residual of the drives of the model file. In those drives, as many "
            f"segments leave {np.exp(own):.2g} times the median, and a road of the next class "
            f"makes {ROAD_CLASS:g} times as much. Something acts there that the model file "
            "does not contain"
        )
        structure = Structure(name, LOUDER, float(np.exp(x - own)) / ROAD_CLASS, text)
        is_large = bool(x - own - lasting[i] > np.log(ROAD_CLASS))
        chance = _chance(x, k, n, spread[i], lasting[i], known[i])
        made.append((chance, is_large, structure))
    p, is_large, structure = min(made, key=lambda q: (not q[1], q[0]))
    yield Question(min(p * len(made), 1.0), is_large, structure)


def _chance(x: float, k: int, n: int, spread: float, lasting: float, known: float) -> float:
    """That the k-th largest of n is x or more: segments scatter by themselves (Student: their
    spread is that of the file), and all together by what is not known of either median."""
    each = stdtr(known, (lasting * LASTING - x) / max(spread, 1e-9))
    return float(WEIGHT @ betainc(k, n - k + 1, each) + ndtr(-FAR))
