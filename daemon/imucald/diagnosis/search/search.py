"""Search for causes on a table of blocks: candidates are compared on data outside their fit.

A cause is named under three conditions. The held-out gain of the cause, without the best block in
fifteen, exceeds chance, corrected for the number of all questions. The parameters of the cause
leave the box of correct model files. The value of the cause is plausible. A rival is reported with
the cause if it is within two standard errors of the paired difference, or if it is worse by fewer
nats than a cause needs to be named. Then the parameters of the cause are freed, and the search
starts again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from imucald.diagnosis.cause_keys import with_shifts
from imucald.diagnosis.causes import family
from imucald.diagnosis.fit.score import Problem, held_out, paired
from imucald.diagnosis.search.low_pass import delay_or_low_pass
from imucald.diagnosis.search.shift import find_shift
from imucald.diagnosis.search.standing import (
    demote,
    eliminate,
    set_aside,
    simplify,
    where_it_leads,
    without,
)
from imucald.diagnosis.search.state import State, refit, shift_steps
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

MOST_NAMED = 6

Tick = Callable[[str], None]


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
        if not more or _is_ended(state) or late():
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


def _is_ended(state: State) -> bool:
    """True if the findings so far end the search."""
    drifts = any(t.hypothesis.pattern is not None for t in state.named)
    return drifts or state.shift is not None or bool(state.implausible)


def _grown(
    state: State, tick: Tick, late: Callable[[], bool], skip: Sequence[str], fallen: set[str]
) -> None:
    """Name the causes that improve the prediction, one after another. fallen: names of causes that
    are not named again."""
    while len(state.named) < MOST_NAMED and not late():
        problem = state.evaluated()
        state.last = _trials(problem, state, skip)
        open_to = [t for t in state.last if t.hypothesis.name not in fallen]
        best = _winner(open_to) or _where_it_leads(problem, replace(state, last=open_to))
        shift = None if state.left_out else find_shift(problem, problem.table.levels)
        if shift is not None and shift.named and (best is None or shift.shown > best.shown):
            # The parts before and after a shift are like two drives, so the search in this one
            # ends.
            state.shift = shift
            state.model = with_shifts(state.model, shift_steps(shift))
            state.evaluated()
            break
        if best is None:
            break
        alike = _alike(best, state.last)
        best, edge = _from_the_edge(problem, state, best)
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
        if best is not chosen and best.is_plausible:
            state.rivals[name].append(best)
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
    for first in list(state.named):
        if first.hypothesis.pattern is not None:
            continue
        rivals = [t for t in state.rivals.get(first.hypothesis.name, [])
                  if t.hypothesis.pattern is None]  # fmt: skip
        for trial in [t for t in state.named if t is not first]:
            h = trial.hypothesis
            if set(h.keys) & set(first.hypothesis.keys) and h.pattern is None:
                continue
            for rival in rivals:
                if late() or first not in state.named or trial not in state.named:
                    break
                if set(rival.hypothesis.keys) & set(h.keys) and h.pattern is None:
                    continue
                other = without(state, first)
                if h.pattern is None:
                    other = without(other, trial)
                _take(other, other.evaluated(), rival)
                refit(other)
                less, whole = other.evaluated(), state.evaluated()
                alone = held_out(less)
                both = held_out(whole, None if h.pattern is None else on_table(h, whole.table))
                behind, se = paired(alone, both, less.table.number, whole.table.number)
                if behind > max(ALIKE_SE * se, trial.needed):
                    continue
                asked = on_table(h, less.table)
                if not tried(less, asked, alone, max(len(state.last), 1)).named:
                    set_aside(state, trial)


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


def _from_the_edge(problem: Problem, state: State, best: Trial) -> tuple[Trial, dict[str, float]]:
    """Test a cause again at the edge of its plausible range if its step leads beyond this range.
    Returns the trial, and the step to the tested place; no step if the second test did not pass."""
    if best.is_plausible or not best.hypothesis.is_plain:
        return best, {}
    again, step = where_it_leads(state, problem, best)
    return (again, step) if again.named and again.is_plausible else (best, {})


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
        state.held |= {k for d in h.directions for k in d} - freed
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
