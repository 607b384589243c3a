"""The present results of a search, and the model that contains these results."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import numpy as np

from imucald.core.arrays import Array
from imucald.diagnosis.cause_keys import (
    Changes,
    extended,
    is_unstated,
    plausible,
    tolerance,
    with_delay_rate,
    with_shifts,
)
from imucald.diagnosis.causes import PARAMETERS
from imucald.diagnosis.equations.forward import Forward
from imucald.diagnosis.fit.blocks import Table, table_of
from imucald.diagnosis.fit.intervals import estimate
from imucald.diagnosis.fit.score import Hypothesis, Problem
from imucald.diagnosis.search.shift import FittedShift
from imucald.diagnosis.search.trials import Trial
from imucald.diagnosis.signals import DriveSignals
from imucald.model.model import VehicleModel

REFITS = 3
SMALL_STEP = 0.05
"""Share of its tolerance by which a parameter may move in a refit that has converged."""


@dataclass
class State:
    """The present results of a search."""

    drives: Sequence[DriveSignals]
    stated: VehicleModel
    """The model file that is tested."""
    model: VehicleModel
    """The model file with all found differences."""
    bounds: dict[str, tuple[float, float]]
    """Bounds from direct evidence, as differences from `model`."""
    at_rest: dict[str, float] = field(default_factory=dict)
    """Differences from `stated` that stops show. Every fit stays within `bounds` of these
    values."""
    changes: dict[str, float] = field(default_factory=dict)
    """Found differences from `stated`, by key."""
    held: set[str] = field(default_factory=set)
    """Parameters that were moved along a direction. `bounds` keeps these parameters within their
    intervals."""
    named: list[Trial] = field(default_factory=list)
    rivals: dict[str, list[Trial]] = field(default_factory=dict)
    implausible: list[Trial] = field(default_factory=list)
    likely: list[Trial] = field(default_factory=list)
    doubtful: list[Trial] = field(default_factory=list)
    """Causes that were first named and later withdrawn."""
    last: list[Trial] = field(default_factory=list)
    """All trials except the findings. These trials show the possible size of each cause."""
    shift: FittedShift | None = None
    doubtful_shift: FittedShift | None = None
    """A shift of the mount that was withdrawn."""
    unstated: tuple[str, ...] = ()
    """Parameters for which the model file allows every plausible value. These parameters are
    estimated, and do not count as causes."""
    left_out: frozenset[str] = frozenset()
    """Equations that no fit uses, because their residuals are unexplained."""
    table: Table | None = None
    whole: Table | None = None
    """The table with all equations, including the equations in `left_out`."""
    forwards: list[Forward] = field(default_factory=list)
    _evaluated: VehicleModel | None = None

    @property
    def free(self) -> list[str]:
        """Parameters that were found to be wrong. These parameters are fitted together with all
        other parameters."""
        return [key for key in self.changes if key not in self.held]

    @property
    def found(self) -> list[str]:
        """Parameters that were found to be wrong. A zero error that a gain moves by less than its
        tolerance is not included, because it may still be wrong by itself."""
        return [
            key
            for key, x in self.changes.items()
            if key not in self.held or abs(x) > tolerance(self.stated, key)
        ]

    def evaluated(self) -> Problem:
        """Evaluate the drives with the present model."""
        if self.table is None or self._evaluated != self.model:
            self.whole, self.forwards = table_of(self.drives, self.model)
            self.table = self.whole.without(self.left_out)
            self._evaluated = self.model
        return Problem.from_table(
            self.table, [k for k in self.free if k in self.table.keys], self.bounds
        )

    def withdraw_shift(self) -> None:
        """Change a shift of the mount to "not ruled out"."""
        self.doubtful_shift, self.shift = self.shift, None
        self.apply({})

    def leave_out(self, equations: Collection[str], stands: Sequence[Trial]) -> None:
        """Exclude some equations from all fits. The named causes `stands` are kept with their
        parameters. The other named causes are changed to "not ruled out"."""
        keys = {key for t in stands for key in t.hypothesis.moved}
        if stands:
            self.evaluated()
            assert self.whole is not None
            keys &= self.whole.without(equations).shown
            stands = [t for t in stands if t.hypothesis.moved & keys]
        self.doubtful = [*(t for t in self.named if not any(t is s for s in stands)),
                         *self.doubtful]  # fmt: skip
        self.named = list(stands)
        for key in self.held - keys:
            self.bounds.pop(key, None)
        self.changes = {k: x for k, x in self.changes.items() if k in keys}
        self.held &= keys
        self.left_out, self.table = frozenset(equations), None
        self.apply({})

    def apply(self, changes: Changes) -> None:
        """Change the model by found differences."""
        for key, x in changes.items():
            self.changes[key] = self.changes.get(key, 0.0) + x
        middle = self.forwards[0].middle_s if self.forwards else 0.0
        every = dict(self.at_rest)
        for key, x in self.changes.items():
            every[key] = every.get(key, 0.0) + x
        self.model = extended(self.stated, with_delay_rate(every, middle))
        if self.shift is not None:
            self.model = with_shifts(self.model, shift_steps(self.shift))


def estimate_unstated(state: State) -> None:
    """Move the stated model to the most likely values of the parameters that the model file does
    not state."""
    keys = state.evaluated().table.keys
    state.unstated = tuple(k for k in keys if is_unstated(state.stated, k))
    state.bounds |= {k: plausible(state.stated, k) for k in state.unstated}
    for _ in range(REFITS if state.unstated else 0):
        x = state.evaluated().fit()
        moves = {k: float(x[keys.index(k)]) for k in state.unstated}
        state.stated = extended(state.stated, moves)
        for key, move in moves.items():
            low, high = state.bounds[key]
            state.bounds[key] = (low - move, high - move)
        state.apply({})
        if all(abs(v) < SMALL_STEP * PARAMETERS[k].tolerance for k, v in moves.items()):
            break


def refit(state: State) -> None:
    """Fit all found parameters together, and evaluate the model again with the result."""
    for _ in range(REFITS):
        problem = state.evaluated()
        x = problem.fit()
        keys = [k for k in state.free if k in problem.table.keys]
        index = problem.table.index(keys)
        state.apply(dict(zip(keys, x[index].tolist(), strict=True)))
        if np.all(np.abs(x[index]) < SMALL_STEP * problem.table.tolerance[index]):
            break


def shift_steps(shift: FittedShift) -> list[tuple[float, Array]]:
    """Return rotations by time: one step, or several small steps for a creep."""
    if shift.kind == "step":
        return [(shift.start_s, shift.turn)]
    # A creep is written as eight steps.
    times = np.linspace(0.0, 1.0, 10)[1:-1]
    starts = shift.low_s + times * (shift.high_s - shift.low_s)
    return [(float(t), shift.turn / len(times)) for t in starts]


def final_estimates(state: State) -> dict[str, tuple[float, float]]:
    """Return, by found parameter, the difference from the stated model and its standard deviation.
    The other parameters are fitted too."""
    if state.table is None or not state.changes:
        return {}
    problem = state.evaluated()
    keys = tuple(k for k in state.free if k in problem.table.keys)
    if not keys:
        return {}
    e = estimate(problem, Hypothesis("all", keys), len(PARAMETERS))
    return {key: (state.changes[key], float(se)) for key, se in zip(keys, e.se, strict=True)}
