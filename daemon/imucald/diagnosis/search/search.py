"""Search for causes on a table of blocks: candidates are compared on data outside their fit.

A cause is named if its held-out gain, without the best block in fifteen, exceeds chance, corrected
for the number of all questions; if its parameters leave the box of correct model files; and if its
value is plausible. A rival is reported with the cause if it is within two standard errors of the
paired difference, or worse by fewer nats than a cause needs to be named. Then the parameters of the
cause are freed, and the search starts again.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from itertools import permutations

import numpy as np

from imucald.diagnosis.causes import CAUSES, family
from imucald.diagnosis.fit.chance import Tick
from imucald.diagnosis.fit.score import Hypothesis, Problem, held_out, paired, without_best
from imucald.diagnosis.search.low_pass import delay_or_low_pass
from imucald.diagnosis.search.shift import find_shift
from imucald.diagnosis.search.state import State, refit
from imucald.diagnosis.search.trials import (
    ALIKE_SE,
    SINGLE_NATS,
    Trial,
    hypotheses,
    joined,
    likeliest,
    on_table,
    tried,
)


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


def search(state: State, tick: Tick, late: Callable[[], bool], skip: Sequence[str] = ()) -> None:
    """Name the causes that improve the prediction, one after another. Then refit all causes, and
    drop the causes that no longer improve the prediction. Another cause may then take the place of
    a dropped cause. A dropped cause is not named again."""
    fallen: set[str] = set()
    while True:
        _grown(state, tick, late, skip, fallen)
        eliminate(state, late)
        demote(state)
        _beside_rivals(state, late)
        more = {t.hypothesis.name for t in state.doubtful} - fallen
        fallen |= more
        drifts = any(t.hypothesis.pattern is not None for t in state.named)
        is_ended = drifts or state.shift is not None or bool(state.implausible)
        if not more or is_ended or late():
            break
    delay_or_low_pass(state)
    if state.doubtful:
        state.last = _trials(state.evaluated(), state, skip)
    known = {t.hypothesis.name for t in (*state.named, *state.doubtful)}
    if state.shift is None:
        state.likely = [
            t
            for t in likeliest(state.last)
            if t.hypothesis.name not in known
            and all(_is_form_of(t, other) for other in _alike(t, state.last))
        ]


def _grown(
    state: State, tick: Tick, late: Callable[[], bool], skip: Sequence[str], fallen: set[str]
) -> None:
    """Name the causes that improve the prediction, one after another. fallen: names of causes that
    are not named again."""
    while len(state.named) < 6 and not late():
        problem = state.evaluated()
        state.last = _trials(problem, state, skip)
        open_to = [t for t in state.last if t.hypothesis.name not in fallen]
        best = _winner(open_to) or _where_it_leads(problem, replace(state, last=open_to))
        shift = None if state.left_out else find_shift(problem)
        if shift is not None and shift.named and (best is None or shift.shown > best.shown):
            # The parts before and after a shift are like two drives, so the search in this one
            # ends.
            state.shift = shift
            state.apply({})
            state.evaluated()
            break
        if best is None:
            break
        alike = _alike(best, state.last)
        edge: dict[str, float] = {}
        if not best.is_plausible and best.hypothesis.is_plain:
            # Its step leads beyond its plausible range, so it is tested again at the edge.
            again, step = where_it_leads(state, problem, best)
            if again.named and again.is_plausible:
                best, edge = again, step
        chosen = next(
            (t for t in [best, *alike] if t.is_plausible and t.hypothesis.name not in fallen),
            None,
        )
        if chosen is None:
            state.implausible.append(best)
            break
        name = chosen.hypothesis.name
        tick(f"found {name.replace('_', ' ')}, looking further")
        state.rivals.setdefault(name, []).extend(
            t for t in alike if t is not chosen and t.is_plausible
        )
        state.named.append(chosen)
        if chosen.hypothesis.pattern is not None:
            # The model file has no place for a drift: like a shift, it ends the search.
            break
        if edge and chosen is best:
            # It was tested at the edge of the plausible range, so the model moves from there.
            state.apply({key: edge[key] for key in beyond(chosen)})
            problem = state.evaluated()
        _take(state, problem, chosen)
        refit(state)
        simplify(state, chosen)


def _beside_rivals(state: State, late: Callable[[], bool]) -> None:
    """Drop named causes that may only be the residual of a wrong look-alike.

    Each of several look-alikes may be the true cause. If another look-alike alone predicts equally
    well and needs no further cause, the further cause is dropped."""
    for first, trial in permutations(list(state.named), 2):
        rivals = [r for r in state.rivals.get(first.hypothesis.name, [])
                  if r.hypothesis.pattern is None and _is_apart(r, trial)]  # fmt: skip
        if first.hypothesis.pattern is not None or not rivals or not _is_apart(first, trial):
            continue
        if late() or first not in state.named or trial not in state.named:
            continue
        less = without(state, first)
        if trial.hypothesis.pattern is None:
            less = without(less, trial)
        if any(not late() and _explains(state, less, rival, trial) for rival in rivals):
            set_aside(state, trial)


def _is_apart(other: Trial, trial: Trial) -> bool:
    """True if another cause does not free the same parameters. A drift is never the same."""
    is_drift = trial.hypothesis.pattern is not None
    return is_drift or not set(other.hypothesis.keys) & set(trial.hypothesis.keys)


def _explains(state: State, less: State, rival: Trial, trial: Trial) -> bool:
    """True if a rival predicts as well as all named causes, and the named cause `trial` would not
    be named in addition to it. less: the state without `trial` and the cause of the rival."""
    other = replace(less, changes=dict(less.changes), held=set(less.held), bounds=dict(less.bounds))
    _take(other, other.evaluated(), rival)
    refit(other)
    problem, whole, h = other.evaluated(), state.evaluated(), trial.hypothesis
    alone = held_out(problem)
    both = held_out(whole, None if h.pattern is None else on_table(h, whole.table))
    behind, se = paired(alone, both, problem.table.number, whole.table.number)
    if behind > max(ALIKE_SE * se, trial.needed):
        return False
    asked = on_table(h, problem.table)
    return not tried(problem, asked, alone, max(len(state.last), 1)).named


def _trials(problem: Problem, state: State, skip: Sequence[str]) -> list[Trial]:
    asked = hypotheses(problem.table, state.model, [*state.found, *state.unstated, *skip])
    base = held_out(problem)
    made = [tried(problem, h, base, len(asked)) for h in asked]
    return [*made, *joined(problem, made, base)]


def _winner(trials: Sequence[Trial]) -> Trial | None:
    """Return the trial with the largest gain among the trials that pass.

    For several forms of one cause, or causes that are part of it, the simplest form that passes is
    chosen. For example, a growing delay is named only if its growth alone improves the prediction.
    """
    passing = [t for t in trials if t.named]
    if not passing:
        return None
    best = max(passing, key=lambda t: t.gain.sum())
    if len(best.hypothesis.directions) > 1:
        # Several joined elements can imitate one other cause.
        fewer = [t for t in passing if len(t.hypothesis.directions) < 2]
        best = max((t for t in fewer if _is_near(best, t)), default=best,
                   key=lambda t: t.gain.sum())  # fmt: skip
    same = [t for t in passing if _is_form_of(t, best)]
    simple = [t for t in same if _is_near(best, t)]
    return min(simple, key=lambda t: (len(t.hypothesis.keys), -t.gain.sum()))


def _is_form_of(t: Trial, best: Trial) -> bool:
    """True if a trial has the same cause, or frees only some of the same parameters."""
    one, all_of = t.hypothesis, best.hypothesis
    is_part = one.is_plain and all_of.is_plain and set(one.keys) < set(all_of.keys)
    return one.name == all_of.name or is_part


def _where_it_leads(problem: Problem, state: State) -> Trial | None:
    """Return the best of the causes that pass at the end of their step, but fail at the stated
    model file."""
    found = [where_it_leads(state, problem, t)[0] for t in state.last if t.may_lead]
    passing = [t for t in found if t.named and t.is_plausible]
    return max(passing, key=lambda t: t.gain.sum(), default=None)


def _is_near(best: Trial, other: Trial) -> bool:
    behind, se = best.ahead_of(other)
    return behind <= ALIKE_SE * se or behind <= SINGLE_NATS / 2.0


def _alike(best: Trial, trials: Sequence[Trial]) -> list[Trial]:
    """Return other causes that are equal to the best cause within two standard errors, or worse by
    fewer nats on unseen data than a cause needs to be named. Causes are therefore ruled out with
    the same error rate as they are named. Only one form of each cause is returned."""
    found: dict[str, Trial] = {}
    for t in sorted(trials, key=lambda t: -t.gain.sum()):
        name = t.hypothesis.name
        if name == best.hypothesis.name or name in found or not t.could_be:
            continue
        behind, se = best.ahead_of(t)
        if behind <= max(ALIKE_SE * se, best.needed):
            found[name] = t
    return list(found.values())


def _take(state: State, problem: Problem, chosen: Trial) -> None:
    """Change the model by a named hypothesis. The derivative along a direction is computed again at
    the new point."""
    h = chosen.hypothesis
    if not h.directions:
        state.apply(problem.moves(h, beyond(chosen)))
        state.held -= {*beyond(chosen)}
        return
    freed = set(state.free)
    for _ in range(2):
        state.apply(problem.moves(h))
        state.held |= h.moved - freed
        problem = state.evaluated()
    half = chosen.estimate.quantile * chosen.estimate.se
    for k, d in enumerate(h.directions):
        for key in d:
            if family(key) == family(h.keys[0]):
                state.bounds[key] = (-float(half[k]), float(half[k]))


def beyond(trial: Trial) -> tuple[str, ...]:
    """Return the parameters of a hypothesis that leave their tolerance."""
    e, h = trial.estimate, trial.hypothesis
    sure = (np.abs(e.value) - trial.tolerance) / np.maximum(e.se, 1e-30)
    far = sure > min(trial.single, float(sure.max()) * 0.999)
    far |= np.arange(len(h.keys)) < h.lead
    return tuple(k for k, is_far in zip(h.keys, far, strict=True) if is_far)
