"""When the solver fits: as soon as evidence has grown, and by the time that a test needs it."""

from __future__ import annotations

import numpy as np
import pytest

from imucald.motion.column_ticks import ticks_from_samples
from imucald.mount.estimate import MountState
from imucald.mount.estimator import FullEstimator
from imucald.mount.evidence_response import GROUP
from imucald.mount.offsets import Offsets
from imucald.mount.restartable_solver import EAGER_BLOCKS, SEGMENT_BLOCKS, RestartableSolver
from imucald.mount.solver import MountSolver
from imucald.simulation import random_model, simulate
from mount_settings import full

SEED = 41
MINUTES = 18


def turns(solvers: RestartableSolver, is_fine: bool, blocks: range) -> list[int]:
    """At which blocks it is a fit's turn; three windows come in four blocks."""
    found = []
    for block in blocks:
        solvers.now.blocks = block
        solvers.now.response.blocks = block * 3 // 4
        if solvers.is_turn(block, is_fine):
            solvers.now.fit()
            found.append(block)
    return found


def test_a_fine_mount_is_fitted_once_a_road_segment():
    solvers = RestartableSolver(full())
    solvers.now.fitted_segment = SEGMENT_BLOCKS * 3 // 4 // GROUP
    found = turns(solvers, True, range(SEGMENT_BLOCKS + 1, 3 * SEGMENT_BLOCKS))
    ended = [block for block in range(SEGMENT_BLOCKS + 1, 3 * SEGMENT_BLOCKS) if block * 3 % 16 < 3]
    assert found == ended
    assert len(found) > 20


def test_where_something_is_waited_for_every_second_block_is_followed_by_a_fit():
    later = range(SEGMENT_BLOCKS + 1, SEGMENT_BLOCKS + 40)
    every_second = [block for block in later if block % 2 == 0]
    assert turns(RestartableSolver(full()), False, later) == every_second
    changed = RestartableSolver(full())
    changed.begin_beside([], Offsets())
    assert turns(changed, True, later) == every_second
    begun = range(EAGER_BLOCKS + 1, SEGMENT_BLOCKS)
    assert turns(RestartableSolver(full()), True, begun) == [k for k in begun if k % 2 == 0]


@pytest.mark.slow
def test_no_fit_is_older_than_a_twentieth_of_the_evidence(monkeypatch):
    made = simulate(random_model(SEED, standing_first=True), SEED, MINUTES)
    estimator, fitted, stale, states = FullEstimator(full()), [0], [], set()
    fit = MountSolver.fit
    taken = 0

    def counted(solver: MountSolver) -> None:
        fit(solver)
        fitted.append(solver.response.blocks)

    monkeypatch.setattr(MountSolver, "fit", counted)
    for row in ticks_from_samples(made.samples, 0, MINUTES * 600).tolist():
        estimator.step(row)
        solver = estimator._solvers.now
        if solver.blocks != taken:
            taken = solver.blocks
            states.add(estimator.state)
            if taken > EAGER_BLOCKS:
                stale.append((solver.response.blocks - fitted[-1]) / taken)
    assert MountState.FINE in states
    assert max(stale) <= 1.0 / EAGER_BLOCKS
    assert np.mean(np.array(stale[-40:]) > 0.0) > 0.5  # and most blocks bring no fit any more
