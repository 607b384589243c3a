"""Segments that leave more than their noise and than a correct file could."""

from __future__ import annotations

import numpy as np
from scipy.stats import beta, chi2
from scipy.stats import f as fisher

from imucald.diagnosis.fit.score import Hypothesis, Problem, one_in_fifteen, what_leaves
from imucald.diagnosis.result import UNEVEN, Structure

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


def uneven(problem: Problem, drift: Hypothesis | None) -> list[Structure]:
    """Segments that leave more than their noise and than a correct file could: something acts in
    some of them that no parameter describes.

    Noise is what half of the segments leave, and how one segment scatters beside their median
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
                f"one segment in fifteen leaves {np.sqrt(size):.2g} times what a correct file may "
                "beside its noise: something acts there, and not in the others"
            )
            found.append(Structure(name, UNEVEN, float(np.sqrt(size)), text))
    return found
