"""Find a sensor that is rotated in the middle of a drive: a step or creep of the mount, from two
sources of evidence.

The first source is kinematics (forces and turning), which does not depend on the road. The second
source is the level: the mean force minus the part that motion explains, divided by g. The road's
slope affects the level only as long-term scatter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucald.core.angles import RAD_PER_DEG as DEG
from imucald.core.arrays import Array
from imucald.diagnosis.fit.intervals import estimate, quantile
from imucald.diagnosis.fit.score import Hypothesis, Problem, explained, held_out, without_best

KEYS = ("mount.turn.x", "mount.turn.y", "mount.turn.z")
LEAST_BLOCKS, LEAST_SHARE = 4, 0.2
"""Smallest number of blocks, and smallest share of all blocks, before and after a candidate."""
LEAST_TURN = 0.3 * DEG
SEARCH = 1.3
"""Factor on the quantile, because many times are tested (Andrews 1993, for the middle 60 %)."""
AGREE_SD, SEEN_SD = 3.0, 2.0
NEIGHBOURS = 3
LEAST_NATS = 8.0
"""Needed nats, as for any cause, with about thirty possible times: ln(30 / 0.01)."""


@dataclass(frozen=True)
class FittedShift:
    """A rotation (3,) [rad] about the vehicle's axes, at one time or linearly over the drive."""

    kind: str
    """`step` or `creep`."""
    start_s: float
    turn: Array
    se: Array
    quantile: float
    gain: Array
    """Held-out nats (B,)."""
    shown: float
    low_s: float
    high_s: float
    """End of the interval of time in which the rotation happened."""

    @property
    def named(self) -> bool:
        """True if the shift exceeds chance, including the search over times."""
        return self.beyond_tolerance > self.threshold and self.shown > LEAST_NATS

    @property
    def beyond_tolerance(self) -> float:
        """Largest excess of an angle over `LEAST_TURN`, in standard deviations."""
        return float(np.max((np.abs(self.turn) - LEAST_TURN) / self.se))

    @property
    def threshold(self) -> float:
        """Excess in standard deviations above which a shift is named."""
        return SEARCH * self.quantile


def find_shift(problem: Problem) -> FittedShift | None:
    """Return the best step or creep of one drive; None if the data cannot show a shift."""
    table, levels = problem.table, problem.table.levels
    if not set(KEYS) <= set(table.keys) or len(set(table.drive.tolist())) != 1:
        return None
    blocks = table.blocks
    edge = max(LEAST_BLOCKS, int(np.ceil(LEAST_SHARE * blocks)))
    places = range(edge, blocks - edge + 1)
    if len(places) == 0:
        return None

    def seen(pattern: Array) -> float:
        """Return the nats by which a pattern of the mount explains kinematics and level."""
        h = Hypothesis("mount_shift", KEYS, pattern=pattern)
        step, se = _level_step(levels, pattern)
        nats = 0.5 * ((step / np.maximum(se, 1e-6)) ** 2).sum() if len(levels) > 6 else 0.0
        return explained(problem.widened(h)[0], problem.fit(h)) + float(nats)

    steps = [(np.arange(blocks) >= k).astype(float) for k in places]
    scores = [seen(p) for p in steps]
    best = int(np.argmax(scores))
    ramp = np.linspace(0.0, 1.0, blocks)
    if seen(ramp) > scores[best] + np.log(len(places)):
        creep = _shift(problem, ramp, "creep", 0)
        if creep.named:
            return creep
    return _shift(problem, steps[best], "step", places[best])


def _level_step(levels: Array, pattern: Array) -> tuple[Array, Array]:
    """Return the regression of the level on a pattern: the step (2,) and its standard deviation.
    The standard deviation includes slow changes of the road."""
    x = pattern - pattern.mean()
    step = x @ levels / (x @ x)
    left = levels - levels.mean(axis=0) - np.outer(x, step)
    size = len(left) // NEIGHBOURS * NEIGHBOURS
    means = left[:size].reshape(-1, NEIGHBOURS, 2).mean(axis=1)
    variance = np.maximum(means.var(axis=0, ddof=1) * NEIGHBOURS, left.var(axis=0, ddof=1))
    se = np.sqrt(variance / (x @ x))
    return step, se


def _shift(problem: Problem, pattern: Array, kind: str, place: int) -> FittedShift:
    """Combine both sources of evidence, weighted by the inverse of their variances."""
    h, table = Hypothesis("mount_shift", KEYS, pattern=pattern), problem.table
    e = estimate(problem, h, 3)
    gain = held_out(problem) - held_out(problem, h)
    turn, se = e.value.copy(), e.se.copy()
    step, step_se = _level_step(table.levels, pattern)
    # A sensor turned by d about y (nose down) measures -g d forward; turned about x it measures +g
    # d to the left.
    by_level = np.array([step[1], -step[0]])
    level_se = step_se[::-1]
    nats = 0.0
    for i in range(2):
        apart = abs(turn[i] - by_level[i]) / np.hypot(se[i], level_se[i])
        seen = abs(turn[i]) > SEEN_SD * se[i]
        if apart < AGREE_SD and seen:
            w, v = 1.0 / se[i] ** 2, 1.0 / level_se[i] ** 2
            turn[i] = (w * turn[i] + v * by_level[i]) / (w + v)
            se[i] = (w + v) ** -0.5
            nats += 0.5 * (by_level[i] / level_se[i]) ** 2
        elif apart >= AGREE_SD:
            # If the two sources contradict each other, they prove nothing.
            se[i] = max(se[i], abs(turn[i] - by_level[i]))
    if kind == "creep":
        low, start, high = (float(table.start_s[i]) for i in (0, 0, -1))
    else:
        start = float(table.start_s[place])
        low, high = float(table.start_s[place - 1]), start
    return FittedShift(
        kind, start, turn, se, quantile(table.blocks, 3), gain,
        without_best(gain) + nats, low, high,
    )  # fmt: skip
