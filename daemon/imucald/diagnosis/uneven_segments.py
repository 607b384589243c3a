"""Segments that leave more than their noise and than a correct file could."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from imucald.diagnosis.result import UNEVEN, Structure
from imucald.diagnosis.score import Hypothesis, Problem, one_in_fifteen, what_leaves

EVEN = ("accel_x", "accel_y", "accel_z")
"""Equations in which nothing of the road is left, nor of the springs."""
LEAST_BLOCKS = 10
CHANCE = 0.01
"""That a segment's noise alone is louder than what is taken for noise."""


def uneven(problem: Problem, drift: Hypothesis | None) -> list[Structure]:
    """Segments that leave more than their noise and than a correct file could: something acts in
    some of them that no parameter describes.

    Noise is what half of the segments leave, and its scatter (chi-square of the coefficients of a
    segment, 1 %). Beyond that a segment may leave what parameters off by their tolerances make in
    it. One segment in fifteen must not decide. drift: of what was named and has no place in the
    model file; it is fitted beside.
    """
    table, z = problem.table, what_leaves(problem, drift)
    found = []
    for name in EVEN:
        there = table.by_equation[name][:, 0, 0] > 0.0 if name in table.plain else np.zeros(0, bool)
        if there.sum() < LEAST_BLOCKS:
            continue
        gram = table.plain[name][there].sum(axis=1)
        power = np.einsum("bi,bij,bj->b", z[there], gram, z[there])
        may = np.einsum("bjj,j->b", gram[:, 1:, 1:], table.tolerance**2)
        count = max(1, int(2.0 * table.seconds * table.top_hz[name]))
        noise = float(np.median(power)) * chi2.isf(CHANCE, count) / chi2.median(count)
        over = np.sort((power - noise) / np.maximum(may, 1e-30))
        size = float(over[len(over) - one_in_fifteen(len(over)) - 1])
        if size > 1.0:
            text = (
                f"one segment in fifteen leaves {np.sqrt(size):.2g} times what a correct file may "
                "beside its noise: something acts there, and not in the others"
            )
            found.append(Structure(name, UNEVEN, float(np.sqrt(size)), text))
    return found
