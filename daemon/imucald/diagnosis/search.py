"""From a table of blocks to names: candidates compete on data that their fit did not see.

A cause is named when its held-out gain, without the best block in fifteen, exceeds what chance
gives in all questions together, when it leaves the box of honest files, and when its value is
plausible. Rivals within two standard errors of the paired difference are named with it. Then it is
freed, and the question is asked anew.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from imucald.diagnosis.blocks import Table, table_of
from imucald.diagnosis.cause_keys import (
    Changes,
    extended,
    with_delay_rate,
    with_shifts,
)
from imucald.diagnosis.causes import PARAMETERS
from imucald.diagnosis.forward import Forward
from imucald.diagnosis.score import (
    Estimate,
    Hypothesis,
    Problem,
    box_fit,
    estimate,
    fitted,
    held_out,
    paired,
    quantile,
    without_best,
)
from imucald.diagnosis.shift import FittedShift, find_shift
from imucald.diagnosis.signals import Array, DriveSignals
from imucald.diagnosis.trials import SINGLE_NATS, Trial, hypotheses, likeliest, tried
from imucald.model.model import VehicleModel

ALIKE_SE = 2.0
MOST_NAMED = 6
REFITS = 3
CREEP_STEPS = 8
SMALL_STEP = 0.05
"""A refit has settled when nothing moves by more than this share of its tolerance."""

Tick = Callable[[str], None]


@dataclass
class State:
    """What is known so far."""

    drives: Sequence[DriveSignals]
    stated: VehicleModel
    """The model file that is put to the test."""
    model: VehicleModel
    """The same with what was found."""
    bounds: dict[str, tuple[float, float]]
    """Boxes from direct evidence, as departures from `model`."""
    at_rest: dict[str, float] = field(default_factory=dict)
    """Departures from `stated` that stops show; every fit keeps within `bounds` of them."""
    changes: dict[str, float] = field(default_factory=dict)
    """Found departures from `stated`, by key."""
    held: set[str] = field(default_factory=set)
    """Parameters that moved by a direction: kept within their interval by `bounds`."""
    named: list[Trial] = field(default_factory=list)
    rivals: dict[str, list[Trial]] = field(default_factory=dict)
    implausible: list[Trial] = field(default_factory=list)
    likely: list[Trial] = field(default_factory=list)
    doubtful: list[Trial] = field(default_factory=list)
    """What was named for a while, and does not stand."""
    last: list[Trial] = field(default_factory=list)
    """All trials beside what was found: what each could have been."""
    shift: FittedShift | None = None
    table: Table | None = None
    forwards: list[Forward] = field(default_factory=list)
    _evaluated: VehicleModel | None = None

    @property
    def free(self) -> list[str]:
        """Parameters that were found to be off, and are fitted with all others."""
        return [key for key in self.changes if key not in self.held]

    def evaluated(self) -> Problem:
        """Put the drives beside the model as it is now."""
        if self.table is None or self._evaluated != self.model:
            self.table, self.forwards = table_of(self.drives, self.model)
            self._evaluated = self.model
        return Problem.of(self.table, [k for k in self.free if k in self.table.keys], self.bounds)

    def give_up(self) -> None:
        """No fit is to be believed: what was named is not ruled out, and no more."""
        self.doubtful = [*self.named, *self.likely, *self.doubtful]
        self.named, self.likely, self.shift = [], [], None
        for key in self.held:
            self.bounds.pop(key, None)
        self.changes, self.held = {}, set()
        self.apply({})

    def apply(self, changes: Changes) -> None:
        """Move the model by found departures."""
        for key, x in changes.items():
            self.changes[key] = self.changes.get(key, 0.0) + x
        middle = self.forwards[0].middle_s if self.forwards else 0.0
        every = dict(self.at_rest)
        for key, x in self.changes.items():
            every[key] = every.get(key, 0.0) + x
        self.model = extended(self.stated, with_delay_rate(every, middle))
        if self.shift is not None:
            self.model = with_shifts(self.model, shift_steps(self.shift))


def search(state: State, tick: Tick, late: Callable[[], bool], skip: Sequence[str] = ()) -> None:
    """Name what pays, one after another; then refit all, and let go what no longer pays."""
    dropped: list[str] = []
    while len(state.named) < MOST_NAMED and not late():
        problem = state.evaluated()
        state.last = _trials(problem, state, [*skip, *dropped])
        best = _winner(state.last) or _nearly(problem, state)
        shift = find_shift(problem, problem.table.levels)
        if shift is not None and shift.named and (best is None or shift.shown > best.shown):
            # Either side of a shift is another drive: nothing else is asked of this one.
            state.shift = shift
            state.model = with_shifts(state.model, shift_steps(shift))
            state.evaluated()
            break
        if best is None:
            break
        alike = _alike(best, state.last)
        chosen = next(
            (t for t in [best, *alike, *_behind(best, state.last)] if t.is_plausible), None
        )
        if chosen is None:
            state.implausible.append(best)
            break
        name = chosen.hypothesis.name
        tick(f"found {name.replace('_', ' ')}, looking further")
        state.rivals[name] = [t for t in alike if t is not chosen and t.is_plausible]
        if best is not chosen and best.is_plausible:
            state.rivals[name].append(best)
        state.named.append(chosen)
        if chosen.hypothesis.pattern is not None:
            # The model file has no place for a drift: like a shift, it ends the search.
            break
        _take(state, problem, chosen)
        refit(state)
        dropped += _let_go(state)
    _eliminate(state, late)
    _demote(state)
    if state.doubtful:
        state.last = _trials(state.evaluated(), state, [*skip, *dropped])
    known = {t.hypothesis.name for t in (*state.named, *state.likely)}
    if state.shift is None:
        state.likely += [t for t in likeliest(state.last) if t.hypothesis.name not in known]


def _trials(problem: Problem, state: State, skip: Sequence[str]) -> list[Trial]:
    asked = hypotheses(problem.table, state.model, [*state.changes, *skip])
    base = held_out(problem)
    return [tried(problem, h, base, len(asked)) for h in asked]


def _winner(trials: Sequence[Trial]) -> Trial | None:
    """The one with most gain of those that pass; of one cause's forms the simplest that does."""
    passing = [t for t in trials if t.named]
    if not passing:
        return None
    best = max(passing, key=lambda t: t.gain.sum())
    same = [t for t in passing if t.hypothesis.name == best.hypothesis.name]
    simple = [t for t in same if _is_near(best, t)]
    return min(simple, key=lambda t: (len(t.hypothesis.keys), -t.gain.sum()))


def _nearly(problem: Problem, state: State) -> Trial | None:
    """What falls short by one step from the stated file may pass where that step led: a column is
    a slope, and 0.002 of understeer at 20 m/s changes its own column by a fifth."""
    close = [t for t in state.last if t.is_suspect and t.shown > t.needed and t.is_testable
             and t.is_plausible and t.hypothesis.is_plain]  # fmt: skip
    if not close:
        return None
    best = max(close, key=lambda t: t.shown)
    there = replace(state, changes=dict(state.changes), table=None)
    there.apply(_changes(problem, best.hypothesis))
    again = _asked_again(there, best)
    return again if again.named and again.is_plausible else None


def _asked_again(state: State, trial: Trial) -> Trial:
    """A hypothesis against the box of honest files, from where the model has moved by it."""
    problem, h = state.evaluated(), trial.hypothesis
    table = problem.table
    kept = [k for k in h.keys if k in state.changes]
    index = [h.keys.index(k) for k in kept]
    if h.is_plain:
        h = replace(h, keys=tuple(kept), lead=min(h.lead, len(kept)))
    low, high = problem.low.copy(), problem.high.copy()
    for key in {k for d in h.directions for k in d} or set(kept):
        i, x = table.keys.index(key), state.changes.get(key, 0.0)
        low[i], high[i] = -table.tolerance[i] - x, table.tolerance[i] - x
    null = replace(problem, low=low, high=high)
    again = tried(problem, h, held_out(null), max(len(state.last), 1), null)
    moved = np.array([state.changes[k] for k in kept])
    e = replace(again.estimate, value=again.estimate.value + moved)
    return replace(again, estimate=e, tolerance=trial.tolerance[index],
                   plausible=trial.plausible[index], reach=trial.reach[index])  # fmt: skip


def _is_near(best: Trial, other: Trial) -> bool:
    behind, se = paired(best.gain, other.gain)
    return behind <= ALIKE_SE * se or behind <= SINGLE_NATS / 2.0


def _alike(best: Trial, trials: Sequence[Trial]) -> list[Trial]:
    """Other causes that do as well within two standard errors; one form of each."""
    found: dict[str, Trial] = {}
    for t in sorted(trials, key=lambda t: -t.gain.sum()):
        name = t.hypothesis.name
        if name == best.hypothesis.name or name in found or not t.could_be:
            continue
        if _is_near(best, t):
            found[name] = t
    return list(found.values())


def _behind(best: Trial, trials: Sequence[Trial]) -> list[Trial]:
    """What passes with half the gain of an explanation that cannot be: it is tried first."""
    if best.is_plausible:
        return []
    passing = [t for t in trials if t.named and t.gain.sum() > 0.5 * best.gain.sum()]
    return sorted(passing, key=lambda t: -t.gain.sum())


def _take(state: State, problem: Problem, chosen: Trial) -> None:
    """Move the model by a named hypothesis; a direction is evaluated once more where it led."""
    h = chosen.hypothesis
    if not h.directions:
        state.apply(_changes(problem, h, beyond(chosen)))
        return
    freed = set(state.free)
    for _ in range(2):
        state.apply(_changes(problem, h))
        state.held |= {k for d in h.directions for k in d} - freed
        problem = state.evaluated()
    half = chosen.estimate.quantile * chosen.estimate.se
    for k, d in enumerate(h.directions):
        for key in d:
            if key.rpartition(".")[0] == h.keys[0].rpartition(".")[0]:
                state.bounds[key] = (-float(half[k]), float(half[k]))


def beyond(trial: Trial) -> tuple[str, ...]:
    """Of a hypothesis' parameters those that leave their tolerance; the others stay within it."""
    e, h = trial.estimate, trial.hypothesis
    sure = (np.abs(e.value) - trial.tolerance) / np.maximum(e.se, 1e-30)
    far = sure > min(trial.single, float(sure.max()) * 0.999)
    far |= np.arange(len(h.keys)) < h.lead
    return tuple(k for k, is_far in zip(h.keys, far, strict=True) if is_far)


def _changes(problem: Problem, h: Hypothesis, only: Sequence[str] = ()) -> dict[str, float]:
    """Departures of a hypothesis' own parameters, with what moves with them. only: these of them;
    the others are fitted within their tolerance, and not moved."""
    if only:
        h = replace(h, keys=tuple(only))
    x = fitted(problem, h)
    own = problem.own(h)
    changes: dict[str, float] = {}
    for k, key in enumerate(h.keys):
        moved = h.directions[k] if h.directions else {key: 1.0}
        for name, factor in moved.items():
            changes[name] = changes.get(name, 0.0) + factor * float(x[own[k]])
    return changes


def refit(state: State) -> None:
    """All found parameters together, the model evaluated anew where it is now."""
    for _ in range(REFITS):
        problem = state.evaluated()
        total = problem.table.gram.sum(axis=0)
        x = box_fit(total[1:, 1:], total[1:, 0], problem.low, problem.high)
        keys = [k for k in state.free if k in problem.table.keys]
        moves = {k: float(x[problem.table.keys.index(k)]) for k in keys}
        state.apply(moves)
        if all(abs(v) < SMALL_STEP * _size(problem, k) for k, v in moves.items()):
            break


def shift_steps(shift: FittedShift) -> list[tuple[float, Array]]:
    """A step, or a creep as a staircase."""
    if shift.kind == "step":
        return [(shift.start_s, shift.turn)]
    times = np.linspace(0.0, 1.0, CREEP_STEPS + 2)[1:-1]
    starts = shift.low_s + times * (shift.high_s - shift.low_s)
    return [(float(t), shift.turn / CREEP_STEPS) for t in starts]


def _size(problem: Problem, key: str) -> float:
    return float(problem.table.tolerance[problem.table.keys.index(key)])


def _let_go(state: State) -> list[str]:
    """Causes that no longer pay beside the later ones are put back; returns their parameters."""
    if len(state.named) < 2:
        return []
    problem = state.evaluated()
    base = held_out(problem)
    gone: list[str] = []
    for trial in state.named[:-1]:
        if not trial.hypothesis.is_plain:
            continue
        keys = [k for k in trial.hypothesis.keys if k in problem.table.keys and k in state.changes]
        low, high = problem.low.copy(), problem.high.copy()
        for key in keys:
            i = problem.table.keys.index(key)
            low[i] = -state.changes[key] - problem.table.tolerance[i]
            high[i] = -state.changes[key] + problem.table.tolerance[i]
        without = held_out(replace(problem, low=np.minimum(low, high), high=np.maximum(low, high)))
        if without_best(without - base) < SINGLE_NATS:
            gone += keys
    if gone:
        state.named = [t for t in state.named if not set(t.hypothesis.keys) & set(gone)]
        for key in gone:
            state.changes.pop(key, None)
        state.apply({})
        refit(state)
    return gone


def final_estimates(state: State) -> dict[str, tuple[float, float, float]]:
    """By found parameter: departure from the stated model, deviation, quantile; others fitted."""
    if state.table is None or not state.changes:
        return {}
    problem = state.evaluated()
    keys = tuple(k for k in state.free if k in problem.table.keys)
    if not keys:
        return {}
    e: Estimate = estimate(problem, Hypothesis("all", keys), len(PARAMETERS))
    q = quantile(problem.table.blocks, 1)
    return {key: (state.changes[key], float(se), q) for key, se in zip(keys, e.se, strict=True)}


def _eliminate(state: State, late: Callable[[], bool]) -> None:
    """Backward elimination: each cause is asked anew from where the others alone lead, weakest
    first. A greedy start may have named a look-alike, or a slope taken at the wrong place."""
    asked: set[str] = set()
    while len(state.named) > 1 and not late():
        left = [t for t in state.named if t.hypothesis.name not in asked]
        if not left:
            break
        trial = min(left, key=lambda t: t.shown)
        asked.add(trial.hypothesis.name)
        if trial.hypothesis.pattern is not None:
            continue
        less = _without(state, trial)
        problem = less.evaluated()
        again = tried(problem, trial.hypothesis, held_out(problem), max(len(state.last), 1))
        if again.named and again.is_plausible:
            continue
        _drop(state, less, trial)
        asked.clear()


def _without(state: State, trial: Trial) -> State:
    """The others alone, fitted anew."""
    h = trial.hypothesis
    keys = {k for d in h.directions for k in d} or set(h.keys)
    less = replace(
        state,
        changes={k: x for k, x in state.changes.items() if k not in keys},
        held=state.held - keys,
        bounds={k: b for k, b in state.bounds.items() if not h.directions or k not in keys},
        table=None,
    )
    less.apply({})
    refit(less)
    return less


def _drop(state: State, less: State, trial: Trial) -> None:
    """A cause does not stand beside the others, whose state is `less`."""
    state.named.remove(trial)
    state.doubtful.append(trial)
    state.changes, state.held, state.bounds = less.changes, less.held, less.bounds
    state.apply({})


def _demote(state: State) -> None:
    """What would not be named again beside all others does not stand."""
    for trial in list(state.named):
        if trial.hypothesis.pattern is None and not _asked_again(state, trial).outside:
            _drop(state, _without(state, trial), trial)
