"""Forward selection of causes: each step asks which cause the drives speak for most.

At each step all drives are linearised at the best point so far; every form of every cause is
tried by its evidence. What is far from linear (delays, low-passes, a shift at an unknown time) is
also tried at a few starting values. A cause that no longer pays is dropped again. At the end each
cause is exchanged for every other: those that explain as much are its look-alikes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from imucald.diagnosis.cause import Cause, Parameter, Variant
from imucald.diagnosis.causes import mount_shift, sensor_lowpass
from imucald.diagnosis.evidence import Fit, solve
from imucald.diagnosis.forward import Forward
from imucald.diagnosis.grid import Array
from imucald.diagnosis.linear import Linearised, linearise, residual_blocks
from imucald.diagnosis.spectra import HOP, OVERLAP_WEIGHT

PRIOR = math.log(0.01)
"""Log prior odds that a given cause is at work."""
ACCEPT = 3.5
"""Log posterior odds above which a cause is accepted in a step."""
ALIKE = 3.0
"""Explanations within this log evidence of the best are look-alikes: odds of 20 to 1."""
BENT_ALIKE = 25.0
"""The same between fits of delays and low-passes, whose shapes are known less well."""
MOST_CAUSES = 8
SAME_SIGNAL = 150.0
"""What a delay must be worth beside a low-pass of the same signal, or the reverse: the two shapes
are hardly told apart."""
STEPS, MOST_STEPS = 2, 5
"""Gauss-Newton steps after each accepted cause; more, and with noise and derivatives of every point
on the way, where the response is bent."""
SETTLED = 0.5
"""Steps end where no parameter moves by more than this many of its tolerances."""
STARTS: Mapping[str, tuple[float, ...]] = {
    "signal_delay": (-0.45, -0.35, -0.25, -0.15, -0.07, 0.07, 0.15, 0.25, 0.35, 0.45),
    "sensor_lowpass": (0.1, 0.2, 0.35, 0.55, 0.8, 1.1, 1.5, 2.1),
}
"""Departures at which causes that are far from linear are tried as well."""
NARROWED = 2
"""Times that the best departure's neighbourhood is halved."""
FAR_FROM = -5.0
"""Log posterior odds near the point from which on starting values far from it are tried."""
FAMILIES = (
    frozenset({"signal_delay", "sensor_lowpass"}),
    frozenset({"mount_shift", "mount_rotation"}),
)
RIVAL_SHARE, MOST_RIVALS = 0.1, 4
SHIFT_MARGIN = 3
"""Stretches at both ends of the drive within which a shift cannot be told."""


@dataclass(frozen=True)
class Trial:
    """One form of one cause, tried on top of the active ones."""

    variant: Variant
    score: float
    """Log posterior odds against leaving it out."""
    start: Mapping[str, float]
    """Values to begin its fit from."""


@dataclass
class Found:
    """Where the search stands."""

    active: list[Variant]
    scores: dict[str, float]
    """Cause to the log posterior odds with which it was accepted."""
    point: Linearised
    tempers: Array
    """(P,) dispersion of the stretches' scores."""
    alike: list[tuple[str, ...]] = field(default_factory=list)
    """Causes whose own fits were as good as that of the first, which is active."""

    @property
    def keys(self) -> list[str]:
        """All parameters of the active causes."""
        return [key for variant in self.active for key in variant.keys]


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
        self._index = {p.key: i for i, p in enumerate(self.parameters)}

    def run(self) -> Found:
        """Search until nothing more pays."""
        found = self._at([], dict(self.base))
        while len(found.active) < MOST_CAUSES:
            trials = self.trials(found)
            rivals = [trial for trial in trials[:1] if trial.score >= ACCEPT]
            rivals = self._rivals(rivals + self._far(found, trials) + trials[1:])
            if not rivals:
                break
            self.tick(rivals[0].variant.cause)
            best = self._contest(found, [self._with(found, trial) for trial in rivals])
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

    def _rivals(self, trials: Sequence[Trial]) -> list[Trial]:
        """Distinct forms and places that only a fit of their own can tell apart.

        Delay and low-pass are the same to first order; so are turns of the mount at some time.
        """
        chosen: list[Trial] = []
        for trial in trials:
            known = [_place(t) for t in chosen]
            family = any(
                trial.variant.cause in f and chosen and chosen[0].variant.cause in f
                for f in FAMILIES
            )
            is_rival = not chosen or bool(trial.start) or family
            is_weak = bool(chosen) and trial.score < RIVAL_SHARE * chosen[0].score
            if is_rival and not is_weak and trial.score >= ACCEPT and _place(trial) not in known:
                chosen.append(trial)
        return chosen[:MOST_RIVALS]

    def _contest(self, before: Found, rivals: Sequence[Found]) -> Found | None:
        """Compare fits at their own best points, each with the noise that it leaves.

        None where the best is not worth its place, although it seemed so from afar.
        """
        least = self._density(before)
        said = []
        for found in rivals:
            name = found.active[-1].cause
            gain = self._density(found) + self._prior_at(found) - least
            # A constant that is left looks like noise of the mean; near the point, what the
            # linear score says of it holds.
            said.append(gain if name in STARTS else max(gain, found.scores[name]))
        said = [
            score if self._can_be(found) else -math.inf
            for found, score in zip(rivals, said, strict=True)
        ]
        worth = [
            score
            if min(score, self.loss(found, found.active[-1])) > _hurdle(found.active)
            else -math.inf
            for found, score in zip(rivals, said, strict=True)
        ]
        if max(worth) == -math.inf:
            return None
        best = rivals[int(np.argmax(worth))]
        newest = best.active[-1]
        near = {
            found.active[-1].cause
            for found, score in zip(rivals, said, strict=True)
            if score > max(worth) - BENT_ALIKE
        }
        if len(near) > 1:
            best.alike = [*best.alike, (newest.cause, *sorted(near - {newest.cause}))]
        return best

    def _can_be(self, found: Found) -> bool:
        return all(sensor_lowpass.is_possible(f.track, found.point.values) for f in self.forwards)

    def _density(self, found: Found) -> float:
        return found.point.density(found.keys, self.base)

    def _prior_at(self, found: Found) -> float:
        """Log prior odds of the newest cause; a shift may be at any of many times."""
        newest = found.active[-1]
        places = len(found.point.present) - 2 * SHIFT_MARGIN
        return self.prior(newest) - (math.log(places) if newest.cause == "mount_shift" else 0.0)

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
            tried += self._shifts(found)
        return sorted(tried, key=lambda trial: -trial.score)

    def prior(self, variant: Variant) -> float:
        """Log prior odds of one form of a cause."""
        return PRIOR - math.log(max(self.forms[variant.cause], 1))

    def temper(self, found: Found, keys: Sequence[str]) -> float:
        """How much fewer the data count for some parameters, from their stretches' scatter."""
        return float(np.mean([found.tempers[self._index[key]] for key in keys])) if keys else 1.0

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
            p = self.parameters[self._index[key]]
            value = found.point.values[key] + float(fit.x[self._index[key]])
            if abs(value - _within(p, value)) > p.tolerance:
                return False
        return True

    def std(self, found: Found, keys: Sequence[str]) -> dict[str, float]:
        """Standard deviation of fitted parameters, model error included."""
        covariance = found.point.evidence.fit(found.keys).covariance
        made = {}
        for key in keys:
            i = self._index[key]
            p = self.parameters[i]
            departure = found.point.values[key] - self.base[key]
            made[key] = math.sqrt(
                float(covariance[i, i]) * float(found.tempers[i])
                + (p.share * departure) ** 2
                + (p.floor * p.tolerance) ** 2
            )
        return made

    def _far(self, found: Found, trials: Sequence[Trial]) -> list[Trial]:
        """Try bent causes where they leave the quietest residual; those that help, best first.

        What is far from the point in a parameter shows near it as well, in it or in its like.
        """
        taken = {key for variant in found.active for key in variant.keys}
        near: dict[Variant, float] = {}
        for trial in trials:
            if trial.variant.cause in STARTS and not taken & set(trial.variant.keys):
                near[trial.variant] = max(trial.score, near.get(trial.variant, -math.inf))
        moved = {_signal_of(k) for v, score in near.items() if score > FAR_FROM for k in v.keys}
        here = found.point.quietness_of([found.point.residual])
        weight = OVERLAP_WEIGHT * len(found.point.present)
        tried = []
        for variant in near:
            if moved & {_signal_of(key) for key in variant.keys}:
                values, quiet = self._quietest(found, variant)
                score = weight * (here - quiet) + self.prior(variant)
                tried.append(Trial(variant, score, {key: values[key] for key in variant.keys}))
        good = [trial for trial in tried if trial.score > ACCEPT]
        return sorted(good, key=lambda trial: -trial.score)

    def _quietest(self, found: Found, variant: Variant) -> tuple[dict[str, float], float]:
        """Move a bent cause to where the residual's spectra are least, by a search on a grid."""

        def at(departure: float) -> dict[str, float]:
            values = dict(found.point.values)
            for key in variant.keys:
                p = self.parameters[self._index[key]]
                values[key] = _within(p, values[key] + departure)
            return values

        def loud(departure: float) -> float:
            whole = [residual_blocks(f, at(departure)) for f in self.forwards]
            return found.point.quietness_of(whole)

        grid = STARTS[variant.cause]
        said = {x: loud(x) for x in grid}
        best = min(said, key=lambda x: said[x])
        i = grid.index(best)
        step = 0.5 * (grid[min(i + 1, len(grid) - 1)] - grid[max(i - 1, 0)])
        for _ in range(NARROWED):
            step *= 0.5
            said |= {x: loud(x) for x in (best - step, best + step)}
            best = min(said, key=lambda x: said[x])
        return at(best), said[best]

    def _shifts(self, found: Found) -> list[Trial]:
        """Try a shift of the mount at every stretch's middle: columns of the mount, cut."""
        normal, evidence = found.point.evidence.normal, found.point.evidence
        variant = next(v for v in self.variants if v.cause == "mount_shift")
        mount = [self._index[f"_mount.{axis}"] for axis in "xyz"]
        shift = [self._index[key] for key in mount_shift.KEYS]
        temper = self.temper(found, [f"_mount.{axis}" for axis in "xyz"])
        without = evidence.fit(found.keys, temper=temper)
        precision = evidence.precision([*found.keys, *mount_shift.KEYS])
        after_A = np.cumsum(normal.information[::-1], axis=0)[::-1]
        after_g = np.cumsum(normal.score[::-1], axis=0)[::-1]
        count = len(normal.score)
        tried = []
        places = range(SHIFT_MARGIN, count - SHIFT_MARGIN)
        for b in places:
            A, g = evidence.A.copy(), evidence.g.copy()
            A[shift, :] = after_A[b][mount, :]
            A[:, shift] = after_A[b][:, mount]
            A[np.ix_(shift, shift)] = after_A[b][np.ix_(mount, mount)]
            g[shift] = after_g[b][mount]
            fit = solve(A / temper, g / temper, evidence.square / temper, precision, evidence.shift)
            score = fit.log_evidence - without.log_evidence + self.prior(variant)
            start = {key: float(fit.x[i]) for key, i in zip(mount_shift.KEYS, shift, strict=True)}
            start[mount_shift.TIME] = self._time(b)
            tried.append(Trial(variant, score - math.log(len(places)), start))
        return tried

    def _time(self, block: int) -> float:
        """Time [s] at which a stretch begins to be new."""
        for forward in self.forwards:
            starts = max(len(forward.track.t) - 2 * HOP, 0) // HOP + 1
            if block < starts:
                return float(forward.track.t[min(block * HOP + HOP // 2, len(forward.track.t) - 1)])
            block -= starts
        return 0.0

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
                stepped[p.key] = _within(p, stepped[p.key] + float(x))
        if any(v.cause == "mount_shift" for v in active):
            stepped = self._timed(point, stepped)
        return stepped

    def _timed(self, point: Linearised, values: dict[str, float]) -> dict[str, float]:
        """Move the time of the shift to where the residual is least."""
        best, least = values, math.inf
        first, last = self._time(SHIFT_MARGIN), self._time(len(point.present) - SHIFT_MARGIN - 1)
        for step in (-24.0, -12.0, -6.0, -3.0, 0.0, 3.0, 6.0, 12.0, 24.0):
            moved = dict(values)
            moved[mount_shift.TIME] = min(max(values[mount_shift.TIME] + step, first), last)
            _, square = point.at([residual_blocks(f, moved) for f in self.forwards])
            if square < least:
                best, least = moved, square
        return best

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


def _hurdle(active: Sequence[Variant]) -> float:
    """Log posterior odds that the newest cause must have."""
    *others, newest = active
    bent = {_signal_of(k) for v in others if v.cause in STARTS for k in v.keys}
    same = newest.cause in STARTS and bent & {_signal_of(key) for key in newest.keys}
    return SAME_SIGNAL if same else ACCEPT


def _seen(variants: Sequence[Variant], forward: Forward) -> list[Variant]:
    """Forms whose parameters change something in this drive."""
    scalars = forward.track.scalars
    absent = {name for name in ("steering", "yaw_rate", "lateral_accel", "longitudinal_accel")
              if name not in scalars}  # fmt: skip
    if forward.track.gyro is None:
        absent.add("gyro")
    return [v for v in variants if v.keys and not any(_signal_of(key) in absent for key in v.keys)]


def _place(trial: Trial) -> tuple[str, str, tuple[float, ...]]:
    """Which form of which cause, begun where; a shift's many times are one place."""
    start = () if trial.variant.cause == "mount_shift" else tuple(trial.start.values())
    return trial.variant.cause, trial.variant.label, start


def _signal_of(key: str) -> str:
    parts = key.split(".")
    return parts[1] if parts[0] == "_lowpass" else parts[0]


def _within(p: Parameter, value: float) -> float:
    low = -math.inf if p.least is None else p.least
    high = math.inf if p.most is None else p.most
    return min(max(value, low), high)
