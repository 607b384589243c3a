"""Test each named cause again together with the other causes."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace

import numpy as np

from imucald.diagnosis.causes import CAUSES
from imucald.diagnosis.fit.score import Hypothesis, Problem, held_out, without_best
from imucald.diagnosis.search.state import State, refit
from imucald.diagnosis.search.trials import Trial, tried


def asked_again(state: State, trial: Trial) -> Trial:
    """Test a hypothesis again, relative to the box of correct model files. The test starts from the
    model that the hypothesis has changed."""
    problem, h = state.evaluated(), trial.hypothesis
    kept = [k for k in h.keys if k in state.changes]
    index = [h.keys.index(k) for k in kept]
    if h.is_plain:
        h = replace(h, keys=tuple(kept), lead=min(h.lead, len(kept)))
    null = put_back(problem, state, list(h.moved))
    again = tried(problem, h, held_out(null), max(len(state.last), 1), null)
    moved = np.array([state.changes[k] for k in kept])
    e = replace(again.estimate, value=again.estimate.value + moved)
    return replace(again, estimate=e, tolerance=trial.tolerance[index],
                   plausible=trial.plausible[index], reach=trial.reach[index])  # fmt: skip


def where_it_leads(state: State, problem: Problem, trial: Trial) -> tuple[Trial, dict[str, float]]:
    """Test a plain cause again at the end of its step, or at the edge of the plausible range if the
    edge is nearer. Returns the trial and the step.

    A column is a derivative, which is valid for small steps only. There are three examples. A
    change of understeer by 0.002 at 20 m/s changes its own column by a fifth. For a steering ratio
    that is a third too large, a linear step leads to half of the error. A speed with a delay of 0.2
    s differs much where the speed changes fast. The likelihood ratio must be computed at the best
    value, and not at the end of one linear step.
    """
    table, step = problem.table, problem.moves(trial.hypothesis)
    for key, x in step.items():
        step[key] = float(np.clip(x, *table.plausible[table.keys.index(key)]))
    there = replace(state, changes=dict(state.changes), table=None)
    there.apply(step)
    return asked_again(there, trial), step


def put_back(problem: Problem, state: State, keys: Sequence[str]) -> Problem:
    """Return the same problem with these parameters limited to the box around the stated model
    file. The model has already moved away from this file."""
    low, high = problem.low.copy(), problem.high.copy()
    for key in keys:
        i, x = problem.table.keys.index(key), state.changes.get(key, 0.0)
        tau = problem.table.tolerance[i]
        low[i], high[i] = -tau - x, tau - x
    return replace(problem, low=low, high=high)


def simplify(state: State, trial: Trial) -> None:
    """Keep a growing cause only if its growth alone improves the prediction with the moved model.
    Otherwise, name the same cause without growth. Columns are derivatives: with a large delay they
    may show a growth that does not exist."""
    h = trial.hypothesis
    first, rest = h.keys[: h.lead], h.keys[h.lead :]
    name = next((c.name for c in CAUSES if rest in c.variants), None)
    if name is None or not first:
        return
    problem = state.evaluated()
    if not set(h.keys) <= set(problem.table.keys):
        return
    without_it = held_out(put_back(problem, state, first))
    if without_best(without_it - held_out(problem)) > trial.needed:
        return
    state.named.remove(trial)
    for key in first:
        state.changes.pop(key, None)
    state.apply({})
    refit(state)
    rivals = state.rivals.pop(h.name, [])
    if not any(key in state.changes for key in rest):
        state.doubtful.append(trial)  # without growth, nothing moved the model
        return
    n = h.lead
    simple = replace(trial, hypothesis=Hypothesis(name, rest), tolerance=trial.tolerance[n:],
                     plausible=trial.plausible[n:], reach=trial.reach[n:])  # fmt: skip
    state.named.append(asked_again(state, simple))
    state.rivals[name] = [t for t in rivals if t.hypothesis.name != name]


def eliminate(state: State, late: Callable[[], bool]) -> None:
    """Do a backward elimination: test each cause again, the weakest first, from the model of the
    other causes alone. The search may have named a look-alike first, or used a derivative at a
    wrong point."""
    asked: set[str] = set()
    while len(state.named) > 1 and not late():
        left = [t for t in state.named if t.hypothesis.name not in asked]
        if not left:
            break
        trial = min(left, key=lambda t: t.shown)
        asked.add(trial.hypothesis.name)
        if trial.hypothesis.pattern is not None:
            continue
        less = without(state, trial)
        problem = less.evaluated()
        again = tried(problem, trial.hypothesis, held_out(problem), max(len(state.last), 1))
        if not again.named and again.may_lead:
            again, _ = where_it_leads(less, problem, again)
        if again.named and again.is_plausible:
            continue
        _drop(state, less, trial)
        asked.clear()


def without(state: State, trial: Trial) -> State:
    """Return the state with the other causes only, fitted again."""
    h = trial.hypothesis
    keys = h.moved
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
    """Remove a cause that fails the test together with the other causes. less: state of the other
    causes."""
    state.named.remove(trial)
    state.doubtful.append(trial)
    state.changes, state.held, state.bounds = less.changes, less.held, less.bounds
    state.apply({})


def demote(state: State) -> None:
    """Drop causes that would not be named again together with all others, and causes that may be
    beyond their plausible range. A cause beyond its plausible range is reported as implausible,
    because another effect explains it."""
    for trial in list(state.named):
        if trial.hypothesis.pattern is None:
            again = asked_again(state, trial)
            if again.outside and again.is_surely_plausible:
                continue
            _drop(state, without(state, trial), trial)
            if again.outside:
                state.implausible.append(again)


def set_aside(state: State, trial: Trial) -> None:
    """Change a named cause to a cause that is not ruled out."""
    if trial.hypothesis.pattern is None:
        _drop(state, without(state, trial), trial)
    else:  # it has no place in the model file, so the model stays
        state.named.remove(trial)
        state.doubtful.append(trial)


def leave_out(state: State, equations: Collection[str], stands: Sequence[Trial]) -> None:
    """Fit without some equations. A cause of `stands` is kept only if it would be named again."""
    state.leave_out(equations, stands)
    if state.named:
        refit(state)
    for trial in list(state.named):
        if trial.hypothesis.pattern is None and not asked_again(state, trial).named:
            set_aside(state, trial)


def unsettle(state: State, doubts: Callable[[Trial], bool]) -> None:
    """Change named causes to "not ruled out" if another effect may explain them. In this case, the
    fit assigns the other effect to these causes."""
    for trial in [t for t in state.named if doubts(t)]:
        set_aside(state, trial)
