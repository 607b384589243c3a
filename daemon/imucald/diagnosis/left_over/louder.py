"""Test whether an equation's residual is larger in some segments than in others, or larger than in
the drives of the model file.

For each equation and frequency band, a model file may contain the median residual over the segments
of its drives and the scatter between segments. Roads also differ: from one class of ISO 8608 to the
next, the rms doubles. If a later drive leaves more than scatter and roads allow, it contains an
effect that the model file does not contain.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise, product

import numpy as np
from scipy.special import betainc, ndtr, stdtr, stdtrit
from scipy.stats import beta, chi2
from scipy.stats import f as fisher

from imucald.core.arrays import Array
from imucald.diagnosis.equations.forward import UNITS
from imucald.diagnosis.fit.beside_file import (
    LEAST_RMS,
    ROAD_CLASS,
    Family,
    FamilyRow,
    beside_file,
    in_both,
)
from imucald.diagnosis.fit.blocks import EQUATIONS
from imucald.diagnosis.fit.chance import Answer
from imucald.diagnosis.fit.score import one_in_fifteen
from imucald.diagnosis.left_over.remains import Remains
from imucald.diagnosis.signals import CHANCE
from imucald.model.leaves import BANDS_HZ, Leaves

EVEN = ("accel_x", "accel_y", "accel_z")
"""Equations whose residuals contain no effect of the road or the springs if gravity is integrated
with a gyroscope."""
LEAST_BLOCKS = 4
"""Smallest number of blocks: with fewer blocks, the median and the one block that must not decide
cannot be separated."""
OF_MEDIAN = 2.0 / np.pi
"""Ratio of the variance of the mean to the variance of the median, for normal variables."""
SHARES = {15: "one segment in fifteen has", 4: "one segment in four has",
          2: "half of the segments have"}  # fmt: skip


def _row(name: str, band: int) -> FamilyRow:
    """Return the test of one number. If roads shake the vehicle at this frequency, the chance is
    computed beyond one road class."""
    low, high = BANDS_HZ[band : band + 2]
    road = float(np.log(ROAD_CLASS))
    is_shaken = low >= EQUATIONS[name].shaken_from_hz
    return FamilyRow(
        road,
        lambda middle, more: (
            f"between {low:g} and {high:g} Hz the residual of half of the segments is at least "
            f"{middle:.2g} {UNITS[name]}. That is {np.exp(more):.2g} times the residual that the "
            f"model file states. A road of the next class gives {ROAD_CLASS:g} times as much. "
            "Something acts there that the model file does not contain"
        ),
        start=road * is_shaken,
    )


LEAVES = Family(_row)
"""Tests of the residuals of segments, by equation and band."""


# single segments ---------------------------------------------------------------------------------


def uneven(left: Remains) -> Iterator[Answer]:
    """Find segments whose residual is larger than their noise and the errors of a correct model
    file. Some of these segments contain an effect that no parameter describes.

    The noise is the median residual of the segments plus the scatter of single segments about this
    median (Fisher's F distribution, because the median of few segments is inaccurate). With the
    limit used here, more than one segment in fifteen exceeds the limit with a chance of 1 %
    (binomial). In addition, a segment may contain the effect of parameters that are wrong by their
    tolerances. A single segment in fifteen must not decide the result.
    """
    table, z = left.table, left.z
    if "gyro_x" not in table.plain:
        return  # the residuals contain each segment's road slope
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
        # Level that more than `few` of n segments exceed with that chance (Clopper, Pearson).
        each = beta.ppf(CHANCE, few + 1, n - few)
        noise = middle * fisher.isf(each, count, OF_MEDIAN * count * n)
        over = np.sort((power - noise) / np.maximum(may, 1e-30))
        size = float(np.sqrt(max(over[n - few - 1], 0.0)))
        text = (
            f"more than one segment in fifteen has at least {size:.2g} times the residual that the "
            "tolerances of a correct model file cause (noise is subtracted): something acts only "
            "in these segments"
        )
        yield Answer(name, size, 1.0, CHANCE, text)


def more_than_stated(left: Remains) -> Iterator[Answer]:
    """Test for larger residuals than the model file states, in one segment in fifteen, in four or
    in two.

    Each equation and band is compared with the file's own drives. Only segments within the speed
    range of the file are used."""
    stated = left.state.stated.leaves
    for seconds, own in left.by_band.items() if stated else ():
        for name, rms, file in in_both(own, stated, seconds, LEAST_BLOCKS):
            yield _of_equation(name, rms, file)


def _of_equation(name: str, rms: Array, file: Leaves) -> Answer:
    """Return the answer for an equation: the strongest result over the shares of segments and over
    all bands except the last. rms: (B, bands) of each segment.

    In equations with road unevenness, a segment may exceed the model file in all bands by as much
    as in the last band: a rougher road is rougher in every band (ISO 8608: all classes have the
    same slope).
    """
    if np.isfinite(EQUATIONS[name].shaken_from_hz):
        rms = rms / np.maximum(rms[:, -1:] / max(file.rms[-1], LEAST_RMS), 1.0)
    logs, _, _, free = beside_file(rms, file)
    logs = logs - np.log(np.maximum(file.rms, LEAST_RMS))
    n, few, spread = len(logs), one_in_fifteen(len(logs)), np.asarray(file.spread)
    # Number of neighbours that count as one for a mean; for a spread it is smaller (Bartlett 1946).
    one = np.broadcast_to((n + file.segments) / (free + 2.0), spread.shape)
    r2 = ((one - 1.0) / (one + 1.0)) ** 2
    known = np.maximum(file.segments * (1.0 - r2) / (1.0 + r2) - 1.0, 1.0)
    lasting = spread * np.sqrt(one * (1.0 / n + 1.0 / file.segments) / OF_MEDIAN)
    made = []
    counted = {max(few + 1, n // share): words for share, words in SHARES.items()}
    for (i, (low, high)), k in product(enumerate(pairwise(BANDS_HZ[:-1])), counted):
        x = float(np.sort(logs[:, i])[-k])
        # Residual that the same share of the file's own segments reaches.
        own = max(float(spread[i] * stdtrit(known[i], 1.0 - k / (n + 1.0))), 0.0)
        text = (
            f"between {low:g} and {high:g} Hz {counted[k]} at least {np.exp(x):.2g} times the "
            "median residual of the drives of the model file. In those drives, the same share of "
            f"segments has {np.exp(own):.2g} times the median. A road of the next class gives "
            f"{ROAD_CLASS:g} times as much. Something acts there that the model file does not "
            "contain"
        )
        p = _chance(x, k, n, spread[i], lasting[i], known[i])
        sure = float(np.exp(x - own - lasting[i]))
        made.append(Answer(name, float(np.exp(x - own)), ROAD_CLASS, p, text, sure=sure))
    best = min(made, key=lambda a: (not a.is_large, a.p))
    return replace(best, p=min(best.p * len(made), 1.0))


def _chance(x: float, k: int, n: int, spread: float, lasting: float, known: float) -> float:
    """Return the chance that the k-th largest of n values is x or more. Single segments scatter
    with the spread that the model file states (Student's t distribution). All segments together
    scatter by the uncertainty of both medians."""
    common = np.linspace(-6.0, 6.0, 121)  # standard deviations
    weight = np.exp(-0.5 * common**2)
    each = stdtr(known, (lasting * common - x) / max(spread, 1e-9))
    return float(weight / weight.sum() @ betainc(k, n - k + 1, each) + ndtr(common[0]))
