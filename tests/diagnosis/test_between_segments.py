"""Segments that differ by more than their errors say, and growth that is not even."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from table_rows import remains

from imucald.diagnosis.fit.blocks import Table
from imucald.diagnosis.fit.chance import beyond_chance
from imucald.diagnosis.fit.intervals import Estimate
from imucald.diagnosis.fit.score import Hypothesis, Problem
from imucald.diagnosis.left_over.courses import by_course, gains_apart
from imucald.diagnosis.search.search import simplify
from imucald.diagnosis.search.state import State
from imucald.diagnosis.search.trials import Trial
from imucald.model.model import VehicleModel

BLOCKS, ROWS = 32, 60
ZERO, GAIN = 0.06, 0.01
RAMP = np.linspace(0.0, 1.0, BLOCKS)
STEP = (np.arange(BLOCKS) >= 12).astype(float)


def problem(seed: int, values, key: str, tolerance: float, size: float = 30.0) -> Problem:
    """One equation of unit noise with one parameter. values: (BLOCKS,) of it in each segment."""
    rng = np.random.default_rng(seed)
    X = size * rng.standard_normal((BLOCKS, ROWS, 1))
    y = rng.standard_normal((BLOCKS, ROWS)) + X[:, :, 0] * np.reshape(values, (-1, 1))
    return problem_of(y, X, (key,), np.array([tolerance]))


def problem_of(y, X, keys, tolerance) -> Problem:
    A = np.concatenate([y[:, :, None], X], axis=2)
    gram = np.swapaxes(A, 1, 2) @ A
    n = len(keys)
    table = Table(
        keys, gram, {"accel_x": gram}, 30.0 * np.arange(BLOCKS),
        np.zeros(BLOCKS, dtype=int), np.ones(BLOCKS), tolerance, np.zeros(n),
        np.tile([-1.0, 1.0], (n, 1)), {"accel_x": 1.0}, 30.0, {}, np.zeros((BLOCKS, 2)),
        np.arange(BLOCKS),
    )  # fmt: skip
    return Problem(table, -tolerance, tolerance)


def trial(h: Hypothesis) -> Trial:
    one = np.ones(len(h.keys))
    e = Estimate(one, 0.01 * one, 3.0, 9.0, 0.0 * one)
    wide = np.tile([-1.0, 1.0], (len(h.keys), 1))
    return Trial(h, e, np.ones(BLOCKS), 50.0, 0.1 * one, wide, 8.0, 2.0, 0.1 * one,
                 np.arange(BLOCKS))  # fmt: skip


def state(*named: Trial) -> State:
    return State((), VehicleModel(), VehicleModel(), {}, named=list(named))


def heated(seed: int) -> np.ndarray:
    """A gain that is another every two minutes, in a random half of them."""
    return 6.0 * GAIN * np.repeat(np.random.default_rng(seed).integers(0, 2, 8), 4)


@pytest.mark.parametrize("seed", range(3))
def test_a_gain_that_comes_and_goes_is_reported_with_its_size(seed):
    gain = heated(seed + 10)
    found = list(gains_apart(remains(problem(seed, gain, "speed.scale", GAIN))))
    assert [a.parameter for a in found] == ["speed.scale"]
    assert found[0].p < 1e-6
    assert found[0].is_large
    assert found[0].structure.size == pytest.approx(np.std(gain) * 3.0**0.5 / GAIN, rel=0.2)


@pytest.mark.parametrize("seed", range(20))
def test_one_gain_however_far_off_or_gains_within_tolerance_are_not(seed):
    rng = np.random.default_rng(200 + seed)
    for gain in (np.full(BLOCKS, 0.08), GAIN * rng.uniform(-1.0, 1.0, BLOCKS)):
        (q,) = gains_apart(remains(problem(seed, gain, "speed.scale", GAIN)))
        assert q.p > 1e-3


def test_one_segment_in_fifteen_does_not_decide():
    gain = np.zeros(BLOCKS)
    gain[[5, 20]] = 0.3
    (q,) = gains_apart(remains(problem(1, gain, "speed.scale", GAIN)))
    assert q.p > 0.05


def test_of_a_zero_segments_are_not_asked():
    """A segment's own takes what its road makes of it."""
    zero = problem(1, 6.0 * heated(1), "accel.bias.x", ZERO, size=3.0)
    assert list(gains_apart(remains(zero))) == []


@pytest.mark.parametrize(("grows", "is_even"), [(RAMP, True), (STEP, False)])
def test_a_drift_stands_where_no_step_does_as_well(grows, is_even):
    drift = Hypothesis("accel_bias_drift", ("accel.bias.x",), pattern=RAMP)
    p = problem(3, 5.0 * ZERO * grows, "accel.bias.x", ZERO, size=3.0)
    left = beyond_chance(by_course(remains(p, drift=drift)))
    assert (left == []) == is_even
    if left:
        assert left[0].parameter == "accel.bias.x"
        assert "from 360 s on" in left[0].text


@dataclass
class Fixed(State):
    """A model beside which nothing moves."""

    problem: Problem | None = None

    def evaluated(self) -> Problem:
        assert self.problem is not None
        free = [k for k in self.free if k in self.problem.table.keys]
        return Problem.from_table(self.problem.table, free, {})

    def apply(self, changes) -> None:
        pass


CLOCKS = ("speed.delay_rate", "speed.delay_s")


def clocks(delay) -> tuple[Fixed, Trial]:
    """A delay [s] of each segment (BLOCKS,), named as one that grows over 300 s."""
    rng = np.random.default_rng(5)
    slope = 3.0 * rng.standard_normal((BLOCKS, ROWS))
    late = slope[:, :, None] * np.stack([300.0 * RAMP, np.ones(BLOCKS)], axis=1)[:, None, :]
    y = rng.standard_normal((BLOCKS, ROWS)) + slope * np.reshape(delay, (-1, 1))
    whole = problem_of(y, late, CLOCKS, np.array([2e-5, 0.03]))
    grows = trial(Hypothesis("delay_rate", CLOCKS, lead=1))
    known = Fixed((), VehicleModel(), VehicleModel(), {}, changes=dict.fromkeys(CLOCKS, 0.0),
                  named=[grows], problem=whole)  # fmt: skip
    return known, grows


@pytest.mark.parametrize(("grows", "is_even"), [(RAMP, True), (STEP, False)])
def test_clocks_run_apart_where_no_step_of_the_delay_does_as_well(grows, is_even):
    known, _ = clocks(0.1 + 0.6 * grows)
    left = beyond_chance(by_course(remains(known.evaluated())))
    assert (left == []) == is_even
    if left:
        assert left[0].parameter == "speed.delay_s"
        assert "from 360 s on" in left[0].text


def test_a_rate_that_does_not_pay_leaves_nothing_where_the_model_has_moved_by_no_delay():
    known, grows = clocks(0.0 * RAMP)
    known.changes = {"speed.delay_rate": 0.0}
    simplify(known, grows)
    assert (known.named, known.doubtful, known.changes) == ([], [grows], {})


@pytest.mark.parametrize(("rate", "name"), [(0.0, "signal_delay"), (2e-3, "delay_rate")])
def test_clocks_that_run_apart_stand_where_their_rate_pays_beside_a_delay(rate, name):
    known, grows = clocks(0.3 + 300.0 * rate * RAMP)
    known.rivals["delay_rate"] = [trial(Hypothesis("signal_delay", CLOCKS[1:]))]
    simplify(known, replace(grows))
    if name == "signal_delay":
        assert [(t.hypothesis.name, t.hypothesis.keys) for t in known.named] == [(name, CLOCKS[1:])]
        assert known.rivals == {"signal_delay": []}
        assert "speed.delay_rate" not in known.changes
    else:
        assert known.named == [grows]
