"""Forward selection of causes: each step asks which cause the drives speak for most.

At each step all drives are linearised at the best point so far; every form of every cause is
tried by its evidence. What is far from linear (`bent`: delays, low-passes; `shifts`: a shift at an
unknown time) is tried away from the point as well, and `contest` decides between what only fits of
their own can tell apart. A cause that no longer pays is dropped again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from imucald.diagnosis.bent import far_trials
from imucald.diagnosis.cause import Cause, Parameter, Variant
from imucald.diagnosis.causes import mount_shift
from imucald.diagnosis.contest import FAMILIES, rivals_of, winner
from imucald.diagnosis.evidence import Fit
from imucald.diagnosis.forward import Forward
from imucald.diagnosis.linear import Linearised, linearise
from imucald.diagnosis.shifts import shift_trials, timed
from imucald.diagnosis.trial import ACCEPT, Found, Trial, signal_of, within

PRIOR = math.log(0.01)
"""Log prior odds that a given cause is at work."""
ALIKE = 3.0
"""Explanations within this log evidence of the best are look-alikes: odds of 20 to 1."""
MOST_CAUSES = 8
STEPS, MOST_STEPS = 2, 5
"""Gauss-Newton steps after each accepted cause; more, and with noise and derivatives of every point
on the way, where the response is bent."""
SETTLED = 0.5
"""Steps end where no parameter moves by more than this many of its tolerances."""


class Search:
    """Finds the causes that the drives show.

    forwards: one per drive. candidates: causes that may be named. tick: told after each step.
    """

    def __init__(
        self,
        forwards: Sequence[Forward],
        causes: Sequence[Cause],
        candidates: Sequence[Cause],
        tick: Callable[[str], None],
    ) -> None:
        self.forwards, self.tick = forwards, tick
        self.parameters: tuple[Parameter, ...] = tuple(
            p for cause in causes for p in cause.parameters
        )
        self.base = forwards[0].base() | {mount_shift.TIME: 0.0}
        self.variants = [v for cause in candidates for v in _seen(cause.variants(), forwards[0])]
        self.forms = {c.name: sum(v.cause == c.name for v in self.variants) for c in candidates}
        self.index = {p.key: i for i, p in enumerate(self.parameters)}

    def run(self) -> Found:
        """Search until nothing more pays."""
        found = self._at([], dict(self.base))
        while len(found.active) < MOST_CAUSES:
            trials = self.trials(found)
            rivals = [trial for trial in trials[:1] if trial.score >= ACCEPT]
            rivals = rivals_of(rivals + far_trials(self, found, trials) + trials[1:])
            if not rivals:
                break
            self.tick(rivals[0].variant.cause)
            best = winner(self, found, [self._with(found, trial) for trial in rivals])
            if best is None:
                break
            found = self._pruned(best, best.active[:-1])
        return self._pruned(found, found.active)

    def _with(self, found: Found, trial: Trial) -> Found:
        """Refit with one more cause."""
        values = dict(found.point.values)
        values.update(trial.start)
        refit = self._refit([*found.active, trial.variant], values, found.scores, found.point)
        refit.scores[trial.variant.cause] = trial.score
        return refit

    # one step --------------------------------------------------------------------------------

    def trials(self, found: Found) -> list[Trial]:
        """Try every form of every cause that is not active; best first."""
        taken = {key for variant in found.active for key in variant.keys}
        tried = [
            self._linear(found, variant)
            for variant in self.variants
            if variant.cause != "mount_shift" and not taken & set(variant.keys)
        ]
        if "mount_shift" in self.forms and not taken & set(mount_shift.KEYS):
            tried += shift_trials(self, found)
        return sorted(tried, key=lambda trial: -trial.score)

    def parameter(self, key: str) -> Parameter:
        """Return the parameter of a key."""
        return self.parameters[self.index[key]]

    def prior(self, variant: Variant) -> float:
        """Log prior odds of one form of a cause."""
        return PRIOR - math.log(max(self.forms[variant.cause], 1))

    def temper(self, found: Found, keys: Sequence[str]) -> float:
        """How much fewer the data count for some parameters, from their stretches' scatter."""
        return float(np.mean([found.tempers[self.index[key]] for key in keys])) if keys else 1.0

    def _linear(self, found: Found, variant: Variant) -> Trial:
        evidence, temper = found.point.evidence, self.temper(found, variant.keys)
        without = evidence.fit(found.keys, temper=temper)
        with_it = evidence.fit([*found.keys, *variant.keys], temper=temper)
        score = with_it.log_evidence - without.log_evidence + self.prior(variant)
        if not self._is_within(found, variant, with_it):
            score = -math.inf
        return Trial(variant, score, {})

    def is_possible(
        self, found: Found, variant: Variant, others: Sequence[str], temper: float
    ) -> bool:
        """Whether a cause, fitted beside other keys, would be something that it can be."""
        fit = found.point.evidence.fit([*others, *variant.keys], temper=temper)
        return self._is_within(found, variant, fit)

    def _is_within(self, found: Found, variant: Variant, fit: Fit) -> bool:
        for key in variant.keys:
            p = self.parameter(key)
            value = found.point.values[key] + float(fit.x[self.index[key]])
            if abs(value - within(p, value)) > p.tolerance:
                return False
        return True

    def std(self, found: Found, keys: Sequence[str]) -> dict[str, float]:
        """Standard deviation of fitted parameters, model error included."""
        covariance = found.point.evidence.fit(found.keys).covariance
        made = {}
        for key in keys:
            i = self.index[key]
            p = self.parameters[i]
            departure = found.point.values[key] - self.base[key]
            made[key] = math.sqrt(
                float(covariance[i, i]) * float(found.tempers[i])
                + (p.share * departure) ** 2
                + (p.floor * p.tolerance) ** 2
            )
        return made

    def refit(self, active: list[Variant], found: Found) -> Found:
        """Keep some of the active causes only; the others go back to the model file's values."""
        values = dict(self.base)
        kept = {key for variant in active for key in variant.keys} | {mount_shift.TIME}
        values.update({k: v for k, v in found.point.values.items() if k in kept})
        names = {variant.cause for variant in active}
        scores = {k: s for k, s in found.scores.items() if k in names}
        return self._refit(active, values, scores, found.point, found.alike)

    # fitting ---------------------------------------------------------------------------------

    def _at(self, active: list[Variant], values: dict[str, float]) -> Found:
        point = linearise(self.forwards, self.parameters, values, self.base)
        evidence = point.evidence
        all_free = evidence.fit(evidence.keys)
        return Found(active, {}, point, evidence.dispersion(all_free.x))

    def _refit(
        self,
        active: list[Variant],
        values: dict[str, float],
        scores: dict[str, float],
        near: Linearised,
        alike: Sequence[tuple[str, ...]] = (),
    ) -> Found:
        """Move to the best point of a set of causes. near: a point with derivatives and noise."""
        keys = [key for variant in active for key in variant.keys]
        bent = bool(active) and any(active[-1].cause in family for family in FAMILIES)
        if bent:
            near = self._at(active, values).point
        for _ in range(MOST_STEPS if bent else STEPS):
            before = values
            values = self._stepped(active, keys, values, near)
            moved = (abs(values[p.key] - before[p.key]) / p.tolerance
                     for p in self.parameters if p.key in keys)  # fmt: skip
            if bent and max(moved, default=0.0) < SETTLED:
                break
            if bent:
                near = self._at(active, values).point
        found = self._at(active, values)
        found.scores = dict(scores)
        found.alike = list(alike)
        return found

    def _stepped(
        self,
        active: Sequence[Variant],
        keys: Sequence[str],
        values: dict[str, float],
        near: Linearised,
    ) -> dict[str, float]:
        """One Gauss-Newton step of some keys, with noise and other derivatives of a point near."""
        point = linearise(self.forwards, self.parameters, values, self.base, near, moved=keys)
        fit = point.evidence.fit(keys)
        stepped = dict(values)
        for p, x in zip(self.parameters, fit.x, strict=True):
            if p.key in keys:
                stepped[p.key] = within(p, stepped[p.key] + float(x))
        if any(v.cause == "mount_shift" for v in active):
            stepped = timed(self, point, stepped)
        return stepped

    def _pruned(self, found: Found, doubted: Sequence[Variant]) -> Found:
        """Drop causes that no longer pay beside the others."""
        for variant in list(doubted):
            rest = [v for v in found.active if v is not variant]
            if self.loss(found, variant) < ACCEPT:
                values = dict(found.point.values)
                for key in variant.keys:
                    values[key] = self.base[key]
                scores = {k: s for k, s in found.scores.items() if k != variant.cause}
                found = self._refit(rest, values, scores, found.point, found.alike)
        return found

    def loss(self, found: Found, variant: Variant) -> float:
        """Log posterior odds that would be lost without an active cause."""
        evidence, temper = found.point.evidence, self.temper(found, variant.keys)
        rest = [key for v in found.active if v is not variant for key in v.keys]
        full = evidence.fit(found.keys, temper=temper).log_evidence
        return full - evidence.fit(rest, temper=temper).log_evidence + self.prior(variant)


def _seen(variants: Sequence[Variant], forward: Forward) -> list[Variant]:
    """Forms whose parameters change something in this drive."""
    scalars = forward.track.scalars
    absent = {name for name in ("steering", "yaw_rate", "lateral_accel", "longitudinal_accel")
              if name not in scalars}  # fmt: skip
    if forward.track.gyro is None:
        absent.add("gyro")
    return [v for v in variants if v.keys and not any(signal_of(key) in absent for key in v.keys)]
