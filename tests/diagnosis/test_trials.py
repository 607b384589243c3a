"""What is likely: in four of five right, over all questions and against all rivals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucald.diagnosis.fit.blocks import Table
from imucald.diagnosis.fit.intervals import Estimate
from imucald.diagnosis.fit.score import Hypothesis, Problem, held_out, paired
from imucald.diagnosis.search.search import _alike
from imucald.diagnosis.search.trials import Trial, joined, likeliest, on_table, tried
from imucald.diagnosis.signals import CHANCE

BLOCKS = 40


def trial(name: str, nats: float, value=0.5, se=0.05, pull=3.0, seed=0) -> Trial:
    """A question with an even gain over the blocks, and some noise."""
    rng = np.random.default_rng(seed)
    gain = np.full(BLOCKS, nats / BLOCKS) + 0.01 * rng.standard_normal(BLOCKS)
    one = np.ones(1)
    e = Estimate(value * one, se * one, 3.0, pull, 0.0 * one)
    return Trial(Hypothesis(name, (name,)), e, gain, nats, 0.1 * one,
                 np.array([[-1.0, 1.0]]), 8.0, 2.0, 0.1 * one, np.arange(BLOCKS))  # fmt: skip


def names(trials: list[Trial]) -> list[str]:
    return [t.hypothesis.name for t in likeliest(trials)]


def test_one_in_twenty_is_not_likely_where_thirty_questions_are_asked():
    idle = [trial(f"idle{i}", -1.0, seed=i) for i in range(30)]
    assert names([trial("a", 4.0), *idle]) == []  # ln(31 / 0.2) = 5.04
    assert names([trial("a", 5.5), *idle]) == ["a"]


def test_a_rival_that_explains_as_much_leaves_neither_likely():
    assert names([trial("a", 20.0, seed=1), trial("b", 20.0, seed=2)]) == []
    assert names([trial("a", 20.0), trial("b", 8.0, seed=2)]) == ["a"]


def test_what_stays_within_its_tolerance_or_cannot_be_is_not_likely():
    assert names([trial("a", 20.0, value=0.1)]) == []
    assert names([trial("a", 20.0, pull=1.0)]) == []
    assert names([trial("a", 20.0, value=1.5)]) == []


def test_a_rival_is_ruled_out_by_as_many_nats_as_name_a_cause():
    """However sure the difference is: eight nats are asked for here, and noise is nearly none."""
    best, near, far = trial("a", 30.0), trial("b", 24.0), trial("c", 18.0)
    assert [t.hypothesis.name for t in _alike(best, [best, near, far])] == ["b"]


def test_each_element_that_joins_others_is_one_more_question():
    """Two elements that pay by themselves: what they do together is asked after both."""
    keys = ("accel.cross_axis.0", "accel.cross_axis.1")
    rng, n = np.random.default_rng(2), len(keys)
    X = rng.standard_normal((BLOCKS, 60, n))
    A = np.concatenate([(X @ np.array([0.5, 0.5]) + 0.3 * rng.standard_normal((BLOCKS, 60)))
                        [:, :, None], X], axis=2)  # fmt: skip
    gram = np.swapaxes(A, 1, 2) @ A
    table = Table(
        keys, gram, {"accel_x": gram}, 30.0 * np.arange(BLOCKS),
        np.zeros(BLOCKS, dtype=int), np.ones(BLOCKS), np.full(n, 0.02), np.zeros(n),
        np.tile([-1.0, 1.0], (n, 1)), {}, 30.0, {}, np.zeros((BLOCKS, 2)), np.arange(BLOCKS),
    )  # fmt: skip
    problem = Problem.from_table(table, (), {})
    base = held_out(problem)
    single = [tried(problem, Hypothesis("accel_cross_axis", (k,), ({k: 1.0},)), base, 2)
              for k in keys]  # fmt: skip
    [both] = joined(problem, single, base)
    assert both.needed == pytest.approx(np.log(3 / CHANCE))


def test_what_was_asked_of_other_blocks_is_compared_on_those_that_both_have():
    """Another delay may leave a block more or less. Only one of them was asked of the first
    block, which speaks against it."""
    rival = trial("rival", 36.0, seed=1)
    rival = replace(rival, gain=np.concatenate([[-60.0], rival.gain[1:]]))
    best = trial("best", 40.0)
    shorter = replace(best, gain=best.gain[1:], number=best.number[1:])
    assert _alike(shorter, [best, rival]) == [rival]
    behind, _ = shorter.ahead_of(rival)
    assert behind == pytest.approx(float((best.gain[1:] - rival.gain[1:]).sum()))


def test_as_many_blocks_that_are_not_the_same_are_compared_time_by_time():
    """One lacks the first block, the other the last: by place, each would stand a block beside."""
    level = 10.0 * np.arange(BLOCKS)
    first, second = level[1:] + 0.5, level[:-1]
    behind, se = paired(first, second, np.arange(1, BLOCKS), np.arange(BLOCKS - 1))
    assert behind == pytest.approx(0.5 * (BLOCKS - 2))
    assert se == pytest.approx(0.0, abs=1e-9)


def test_a_drift_is_asked_of_another_table_over_that_ones_blocks():
    rng = np.random.default_rng(3)

    def table(blocks: np.ndarray) -> Table:
        A = rng.standard_normal((len(blocks), 60, 2))
        gram = np.swapaxes(A, 1, 2) @ A
        one = np.ones(1)
        return Table(
            ("accel.bias.x",), gram, {"accel_x": gram}, 30.0 * blocks,
            np.zeros(len(blocks), dtype=int), np.ones(len(blocks)), 0.02 * one, 0.0 * one,
            np.array([[-1.0, 1.0]]), {}, 30.0, {}, np.zeros((len(blocks), 2)), blocks,
        )  # fmt: skip

    drift = Hypothesis("accel_bias_drift", ("accel.bias.x",), pattern=np.linspace(0.0, 1.0, BLOCKS))
    same, fewer = table(np.arange(BLOCKS)), table(np.arange(0, BLOCKS, 2))
    assert on_table(drift, same) is drift
    problem = Problem.from_table(fewer, (), {})
    again = tried(problem, on_table(drift, fewer), held_out(problem), 2)
    assert len(again.gain) == len(fewer.start_s)
    assert again.hypothesis.pattern == pytest.approx(np.linspace(0.0, 1.0, BLOCKS // 2))
