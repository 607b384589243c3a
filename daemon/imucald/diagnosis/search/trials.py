"""Hypotheses of the catalogue, and the result of freeing the parameters of each hypothesis."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t as student

from imucald.core.arrays import Array, Index
from imucald.diagnosis.cause_keys import level_effect
from imucald.diagnosis.causes import ACCEL_BIAS, CAUSES, MODEL_ERROR, Cause, family
from imucald.diagnosis.fit.blocks import Table
from imucald.diagnosis.fit.intervals import Estimate, estimate
from imucald.diagnosis.fit.score import Hypothesis, Problem, held_out, paired, without_best
from imucald.diagnosis.signals import CHANCE
from imucald.model.model import VehicleModel

SINGLE = 0.05
"""Error rate of a single question. Weaker hypotheses are ignored."""
SINGLE_NATS = -math.log(SINGLE)
"""Needed nats of a single question. If nothing is wrong, a likelihood ratio on data outside the fit
exceeds 1/p with a chance of at most p (Markov)."""
ALIKE_SE = 2.0
"""Number of standard errors of their difference within which two causes count as equal."""
FALSE_SHARE = 0.2
"""Share of the causes reported as likely that may be false: one in five."""
LEVELLED = ("accel_scale", "accel_cross_axis")


@dataclass(frozen=True)
class Trial:
    """Result of freeing a hypothesis's parameters."""

    hypothesis: Hypothesis
    estimate: Estimate
    gain: Array
    """Increase (B,) of each block's log-likelihood [nats], from a fit that did not use the
    block."""
    shown: float
    """Sum of `gain` without the best blocks."""
    tolerance: Array
    plausible: Array
    needed: float
    """Needed nats, corrected for the number of questions."""
    single: float
    """Quantile of Student's t for a single question."""
    reach: Array
    """Smallest differences (k,) at which a parameter that moves with the hypothesis leaves its
    tolerance."""
    number: Index
    """Index (B,) of the block of each gain, among all blocks of the drives."""

    def ahead_of(self, other: Trial) -> tuple[float, float]:
        """Return the nats by which this trial is better than another trial, and their standard
        error."""
        return paired(self.gain, other.gain, self.number, other.number)

    @property
    def outside(self) -> bool:
        """True if the parameters leave the box of correct model files by more than chance."""
        return self.is_beyond and self.estimate.pull > self.estimate.quantile

    @property
    def is_beyond(self) -> bool:
        """True if a value exceeds its tolerance by at least one standard deviation."""
        beyond = np.abs(self.estimate.value) > self.tolerance + self.estimate.se
        return bool(np.any(beyond[: self.hypothesis.lead or len(beyond)]))

    @property
    def is_suspect(self) -> bool:
        """True if the parameters leave the box of correct model files, at the error rate of a
        single question."""
        return self.is_beyond and self.estimate.pull > self.single

    @property
    def is_plausible(self) -> bool:
        """True if all values beyond their tolerances are plausible for a vehicle or a sensor."""
        v, tau = self.estimate.value, self.tolerance
        low, high = self.plausible.T
        return bool(np.all((np.abs(v) <= tau) | ((v >= low) & (v <= high))))

    @property
    def is_surely_plausible(self) -> bool:
        """True if all values beyond their tolerances are plausible, with a margin of at least one
        standard deviation."""
        v, half = self.estimate.value, self.estimate.se
        if self.hypothesis.directions:
            # A zero error within its tolerance moves the value by `reach`, so that much is no sign
            # of another cause.
            half = np.maximum(half - self.reach, 0.0)
        low, high = self.plausible.T
        within = (v - half >= low) & (v + half <= high)
        return bool(np.all((np.abs(v) <= self.tolerance) | within))

    @property
    def is_testable(self) -> bool:
        """True if the data determine the parameters better than the plausible range does."""
        e = self.estimate
        return bool(np.all(e.quantile * e.se < 0.5 * (self.plausible[:, 1] - self.plausible[:, 0])))

    @property
    def may_lead(self) -> bool:
        """True if a value exceeds its tolerance and the cause can be tested at the end of its
        step."""
        return (
            self.is_beyond and self.is_testable and self.is_plausible and self.hypothesis.is_plain
        )

    @property
    def could_be(self) -> bool:
        """True if the cause may be a rival: it improves the prediction, and a value exceeds its
        tolerance. A rival need not reach the significance that a named cause needs."""
        far = (np.abs(self.estimate.value) > self.reach)[: self.hypothesis.lead or None]
        return self.shown > SINGLE_NATS and bool(np.any(far)) and self.is_testable

    @property
    def named(self) -> bool:
        """True if the trial passes all tests of a single hypothesis."""
        return self.shown > self.needed and self.outside and self.is_testable


def hypotheses(table: Table, model: VehicleModel, skip: Sequence[str]) -> list[Hypothesis]:
    """Return hypotheses for the catalogue's causes whose signals are present. skip: parameters that
    are not tested. The other components of the same vector are tested."""
    made = []
    exact = {key for key, tau in zip(table.keys, table.tolerance, strict=True) if tau == 0.0}
    shown = table.shown - exact
    for cause in CAUSES:
        for whole in (*cause.variants, *([cause.together] if cause.together else [])):
            if not all(key in table.keys for key in whole):
                continue
            # A component that was within its tolerance when the others were found may leave it
            # later. Leading parameters, common values and drifts are asked as a whole.
            fixed = whole if cause.drift or whole == cause.together else whole[: cause.lead]
            keys = fixed + tuple(k for k in whole[len(fixed) :] if k not in skip)
            if (set(fixed) & set(skip) and not cause.drift) or not set(keys) & shown:
                continue
            beside = dict(cause.with_it)
            if beside and set(beside) <= set(table.keys) and not set(beside) & set(skip):
                made.append(Hypothesis(cause.name, keys, ({keys[0]: 1.0, **beside},)))
            level = cause.name in LEVELLED and not set(ACCEL_BIAS) & set(skip)
            made.append(_hypothesis(cause, keys, model, table, level))
    return made


def _hypothesis(
    cause: Cause, keys: tuple[str, ...], model: VehicleModel, table: Table, level: bool
) -> Hypothesis:
    """Return the hypothesis of a cause. level: True if an accelerometer gain also changes the
    reading of one g. Once a zero error was found, only motion shows the gain."""
    if cause.drift:
        return Hypothesis(cause.name, keys, pattern=_ramp(table))
    if keys == cause.together:
        whole: dict[str, float] = dict.fromkeys(keys, 1.0)
        for key in keys if level else ():
            for name, x in level_effect(model, key).items():
                whole[name] = whole.get(name, 0.0) + x
        # A common gain of all axes acts along every vehicle axis in any mount, so it shows as well
        # as the gain of an upright axis.
        of_one = {family(key) for key in keys}
        error = MODEL_ERROR.get(of_one.pop(), 0.0) if len(of_one) == 1 else None
        return Hypothesis(cause.name, keys[:1], (whole,), error=error)
    if not level:
        return Hypothesis(cause.name, keys, lead=cause.lead)
    moved = tuple({key: 1.0, **level_effect(model, key)} for key in keys)
    return Hypothesis(cause.name, keys, moved)


def on_table(h: Hypothesis, table: Table) -> Hypothesis:
    """Adapt a drift's pattern to the blocks of another table. The table of another model may
    contain other blocks."""
    if h.pattern is None or len(h.pattern) == table.blocks:
        return h
    return replace(h, pattern=_ramp(table))


def _ramp(table: Table) -> Array:
    """Return a pattern that grows linearly from 0 to 1 over each drive."""
    made = np.zeros(table.blocks)
    for i in set(table.drive.tolist()):
        own = table.drive == i
        t = table.start_s[own]
        made[own] = (t - t.min()) / max(float(np.ptp(t)), 1.0)
    return made


def tried(
    problem: Problem, h: Hypothesis, base: Array, questions: int, null: Problem | None = None
) -> Trial:
    """Free the parameters of a hypothesis and return its trial. base: (B,) held-out losses with the
    box of correct model files. null: problem with this box, if the model has already left the box.
    """
    gain = base - held_out(problem, h)
    index = problem.table.index(h.keys)
    t = problem.table
    return Trial(h, estimate(problem, h, questions, null), gain, without_best(gain),
                 t.tolerance[index], t.plausible[index], math.log(questions / CHANCE),
                 float(student.ppf(1.0 - 0.5 * SINGLE, t.blocks - 1)), _reach(t, h),
                 t.number)  # fmt: skip


def joined(problem: Problem, trials: Sequence[Trial], base: Array) -> list[Trial]:
    """Combine variants of one cause. A variant is added if it improves the prediction of unseen
    data in addition to the variants before it. For example, three elements of a gain may be wrong
    together. Each combination counts as one more question."""
    made, asked = [], len(trials)
    for cause in CAUSES:
        own = [t for t in trials if cause.joins and t.hypothesis.name == cause.name]
        best = max(own, key=lambda t: t.gain.sum(), default=None)
        while best is not None and best.shown > best.needed:
            beside = [t for t in own if not set(t.hypothesis.keys) & set(best.hypothesis.keys)]
            asked += len(beside)
            one = best.hypothesis
            more = [
                tried(problem, Hypothesis(one.name, (*one.keys, *h.keys),
                                          (*one.directions, *h.directions)), base, asked)
                for h in (t.hypothesis for t in beside)
            ]  # fmt: skip
            following = max(more, key=lambda t: t.gain.sum(), default=None)
            if following is None or without_best(following.gain - best.gain) <= best.needed:
                break
            made.append(best := following)
    return made


def _reach(table: Table, h: Hypothesis) -> Array:
    """Return the smallest differences at which a coupled parameter leaves its tolerance. For
    example, a gain error of 1 % changes a zero error by 1 % of one g, which is more than the
    tolerance of the zero error."""
    own = table.tolerance[table.index(h.keys)]
    if not h.directions:
        return np.asarray(own)
    return np.array(
        [
            min(table.tolerance[table.keys.index(k)] / abs(x) for k, x in d.items() if x)
            for d in h.directions
        ]
    )


def questions(trials: Sequence[Trial]) -> dict[str, Trial]:
    """Return the best trial of each cause, the trial with the most nats first."""
    best: dict[str, Trial] = {}
    for t in sorted(trials, key=lambda t: -t.shown):
        best.setdefault(t.hypothesis.name, t)
    return best


def likeliest(trials: Sequence[Trial]) -> list[Trial]:
    """Return the causes of which at most one in five is expected to be false. The share of false
    causes is counted over all questions together. Each cause is tested against all rivals.

    A likelihood ratio on unseen data is an e-value. If the k largest of M values exceed M/(k
    share), at most this share of them is false, for any dependence between the values (e-BH; Wang
    and Ramdas 2022). As a second condition, no other cause may explain more in a share 1 -
    `FALSE_SHARE` of resampled drives (pseudo-BMA with the Bayesian bootstrap over blocks; Yao et
    al. 2018).
    """
    best = list(questions(trials).values())
    nats = [t.shown - math.log(len(trials) / (FALSE_SHARE * (k + 1))) for k, t in enumerate(best)]
    count = max((k + 1 for k, x in enumerate(nats) if x >= 0.0), default=0)
    if not count:
        return []
    gains = np.array([t.gain for t in best])
    weights = np.random.default_rng(0).dirichlet(np.ones(gains.shape[1]), 1000)
    first = np.argmax(gains @ weights.T, axis=0)
    share = np.bincount(first, minlength=len(best)) / len(weights)
    return [
        t
        for t, x in zip(best[:count], share[:count], strict=True)
        if x >= 1.0 - FALSE_SHARE and t.is_suspect and t.is_surely_plausible and t.is_testable
    ]
