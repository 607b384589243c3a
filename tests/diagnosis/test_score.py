"""Box fits, held-out losses and intervals, on tables made by hand: no cause is known here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from imucald.diagnosis.fit.blocks import Table
from imucald.diagnosis.fit.box import box_fit
from imucald.diagnosis.fit.intervals import estimate, quantile
from imucald.diagnosis.fit.score import Hypothesis, Problem, held_out, without_best

KEYS = ("accel.bias.x", "accel.bias.y", "speed.scale")


def table(x=(0.0, 0.0, 0.0), blocks=40, rows=30, seed=0, noise=1.0, loud=None) -> Table:
    """y = X x + noise, whitened; tolerance 0.1 each."""
    rng = np.random.default_rng(seed)
    grams = []
    for b in range(blocks):
        X = rng.standard_normal((rows, len(KEYS)))
        here = np.asarray(x[b] if np.ndim(x) == 2 else x)
        size = noise if loud is None else noise * loud[b]
        y = X @ here + size * rng.standard_normal(rows)
        A = np.column_stack([y, X])
        grams.append(A.T @ A)
    gram = np.array(grams)
    return Table(
        KEYS, gram, {"accel_x": gram}, 30.0 * np.arange(blocks),
        np.zeros(blocks, dtype=int), np.ones(blocks), np.full(3, 0.1), np.zeros(3),
        np.tile([-1.0, 1.0], (3, 1)), {}, 30.0, {}, np.zeros((blocks, 2)), np.arange(blocks),
    )  # fmt: skip


def problem(t: Table) -> Problem:
    return Problem.from_table(t, (), {})


def test_a_box_fit_is_the_bounded_least_squares_of_scipy():
    rng = np.random.default_rng(1)
    for _ in range(60):
        n = int(rng.integers(2, 30))
        A = rng.standard_normal((n + 5, n)) * 10.0 ** rng.uniform(-3, 3, n)
        b = 10.0 * rng.standard_normal(n + 5)
        low, high = -(10.0 ** rng.uniform(-4, 2, n)), 10.0 ** rng.uniform(-4, 2, n)
        mine = box_fit(A.T @ A, A.T @ b, low, high)
        theirs = lsq_linear(A, b, (low, high), method="bvls", tol=1e-14).x
        assert (mine >= low - 1e-12).all()
        assert (mine <= high + 1e-12).all()
        lost = np.sum((A @ mine - b) ** 2), np.sum((A @ theirs - b) ** 2)
        assert lost[0] <= lost[1] * (1.0 + 1e-9)


def test_what_lies_within_the_tolerance_is_no_gain_and_what_lies_beyond_is():
    h = Hypothesis("x", KEYS[:1])
    within, beyond = problem(table((0.08, 0.0, 0.0))), problem(table((0.5, 0.0, 0.0)))
    assert np.sum(held_out(within) - held_out(within, h)) < 2.0
    gain = held_out(beyond) - held_out(beyond, h)
    # 40 blocks of 30 rows: half of 1200 * 0.4^2 nats.
    assert np.sum(gain) == pytest.approx(96.0, rel=0.4)
    assert without_best(gain) > 50.0


def test_an_interval_holds_the_truth_and_widens_with_the_questions():
    inside = 0
    for seed in range(60):
        e = estimate(problem(table((0.3, 0.05, -0.05), seed=seed)), Hypothesis("x", KEYS[:1]), 1)
        inside += bool(abs(e.value[0] - 0.3) <= e.quantile * e.se[0])
    assert inside >= 57  # 99 %
    assert quantile(30, 31) > quantile(30, 1) > quantile(300, 1) > 2.5


def test_the_box_pulls_by_the_deviations_that_it_costs():
    """One parameter, the others known: (0.5 - 0.1) / (1 / sqrt(1200))."""
    p = problem(table((0.5, 0.0, 0.0), seed=3))
    e = estimate(p, Hypothesis("x", KEYS[:1]), 1)
    assert e.pull == pytest.approx(0.4 * np.sqrt(1200.0), rel=0.35)
    at_home = problem(table((0.05, 0.0, 0.0)))
    assert estimate(at_home, Hypothesis("x", KEYS[:1]), 1).pull < 2.0


def test_false_alarms_stay_at_their_rate():
    """100 tables without an effect, at the edge of the tolerance: the pull hardly passes 2.6."""
    pulls = [
        estimate(problem(table((0.1, -0.1, 0.1), seed=s)), Hypothesis("x", KEYS[:1]), 1).pull
        for s in range(100)
    ]
    assert np.sum(np.array(pulls) > 2.6) <= 4


def test_a_wandering_parameter_has_a_wide_interval():
    steady = np.tile([0.3, 0.0, 0.0], (40, 1))
    moving = steady.copy()
    moving[:, 0] += np.repeat([-0.3, 0.3, -0.2, 0.2], 10)
    h = Hypothesis("x", KEYS[:1])
    calm, restless = (estimate(problem(table(x, seed=3)), h, 1) for x in (steady, moving))
    assert calm.wander[0] < 0.05
    assert restless.wander[0] == pytest.approx(0.29, abs=0.1)
    assert restless.se[0] > 3.0 * calm.se[0]


def test_what_the_equations_err_by_does_not_shrink_with_the_data():
    """Ten times the blocks: a tenth of the variance of noise, all of that of the equations."""
    h = Hypothesis("x", KEYS[:1])
    few, many = (replace(table(blocks=n), model_error=np.full(3, 0.05)) for n in (40, 400))
    assert estimate(problem(few), h, 1).se[0] > 0.05
    assert estimate(problem(many), h, 1).se[0] == pytest.approx(0.05, rel=0.1)
    off = replace(table((0.2, 0.0, 0.0), blocks=400), model_error=np.full(3, 0.05))
    assert estimate(problem(off), h, 1).pull == pytest.approx(2.0, rel=0.15)  # (0.2 - 0.1) / 0.05


def test_a_step_is_found_by_its_pattern():
    x = np.zeros((40, 3))
    x[20:, 1] = 0.6
    step = (np.arange(40) >= 20).astype(float)
    p = problem(table(x))
    h = Hypothesis("step", ("accel.bias.y",), pattern=step)
    e = estimate(p, h, 1)
    assert e.value[0] == pytest.approx(0.6, abs=0.2)
    assert np.sum(held_out(p) - held_out(p, h)) > 20.0


def test_a_direction_moves_its_parameters_together():
    p = problem(table((0.4, -0.4, 0.0)))
    h = Hypothesis("d", ("accel.bias.x",), ({"accel.bias.x": 1.0, "accel.bias.y": -1.0},))
    assert estimate(p, h, 1).value[0] == pytest.approx(0.4, abs=0.1)


def test_direct_evidence_bounds_the_fit():
    t = table((0.5, 0.0, 0.0))
    bound = Problem.from_table(t, (), {"accel.bias.x": (-0.02, 0.02)})
    assert abs(bound.fit()[0]) <= 0.02 + 1e-9
    free = Problem.from_table(t, ("accel.bias.x",), {})
    assert free.fit()[0] == pytest.approx(0.5, abs=0.08)


def test_one_block_does_not_decide():
    gain = np.zeros(45)
    gain[7] = 1000.0
    assert without_best(gain) == 0.0


def test_rows_that_are_not_there_change_nothing():
    t = table((0.5, 0.0, 0.0))
    empty = replace(t, gram=np.concatenate([t.gram, np.zeros((3, 4, 4))]))
    assert problem(empty).fit() == pytest.approx(problem(t).fit())
