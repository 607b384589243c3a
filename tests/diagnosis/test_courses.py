"""Zeros, gains and delays that are not the same all along."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations
from math import comb

import numpy as np
import pytest
from scipy.stats import norm
from table_rows import remains

from imucald.diagnosis.fit.blocks import Table
from imucald.diagnosis.fit.chance import Answer, beyond_chance
from imucald.diagnosis.fit.score import Problem
from imucald.diagnosis.left_over.courses import _share_of_orders, by_course
from imucald.diagnosis.left_over.table import LEFT
from imucald.diagnosis.result import Structure

BLOCKS, ROWS = 48, 60
TOLERANCE = 0.06
KEYS = ("accel.bias.x", "accel.scale.0")


def problem(seed: int, offset=0.0) -> Problem:
    """One equation of unit noise with a zero and a gain. offset: (BLOCKS,) of the zero."""
    rng = np.random.default_rng(seed)
    X = np.stack([np.full((BLOCKS, ROWS), 10.0), rng.standard_normal((BLOCKS, ROWS))], axis=2)
    y = rng.standard_normal((BLOCKS, ROWS)) + X[:, :, 0] * np.reshape(offset, (-1, 1))
    return problem_of(y, X)


def problem_of(y, X) -> Problem:
    """y: (BLOCKS, rows) residual. X: (BLOCKS, rows, 2) columns of a zero and a gain."""
    A = np.concatenate([y[:, :, None], X], axis=2)
    gram = np.swapaxes(A, 1, 2) @ A
    tolerance = np.array([TOLERANCE, 0.01])
    table = Table(
        KEYS, gram, {"accel_x": gram}, 30.0 * np.arange(BLOCKS),
        np.zeros(BLOCKS, dtype=int), np.ones(BLOCKS), tolerance, np.zeros(2),
        np.array([[-1.0, 1.0], [-0.1, 0.1]]), {}, 30.0, {}, np.zeros((BLOCKS, 2)),
        np.arange(BLOCKS),
    )  # fmt: skip
    return Problem(table, -tolerance, tolerance)


def found(p: Problem, how: str = "") -> list[Structure]:
    """What is reported; how: only of questions whose text has it."""
    (row,) = (row for row in LEFT if row.statistic is by_course)
    return beyond_chance(a for a in row.asked(remains(p)) if how in a.text)


def large(signal: str, p: float, rare: float = 1.0) -> Answer:
    return Answer(signal, 2.0, 1.0, p, "", rare=rare)


def structures(p: Problem) -> set[tuple[str, str]]:
    return {(s.kind, s.text.split()[0]) for s in found(p)}


def test_a_zero_that_jumps_every_four_minutes_wanders():
    jumps = np.repeat(np.random.default_rng(3).standard_normal(6), 8) * 2.0 * TOLERANCE
    assert ("wanders", "accel.bias.x") in structures(problem(1, jumps))


@pytest.mark.parametrize("seed", range(8))
def test_a_zero_that_stays_does_not_wander(seed):
    assert structures(problem(seed, np.full(BLOCKS, 0.5 * TOLERANCE))) == set()


def test_a_zero_that_goes_within_its_tolerance_is_not_reported():
    drift = 0.5 * TOLERANCE * np.linspace(-1.0, 1.0, BLOCKS)
    assert structures(problem(2, drift)) == set()


def test_of_many_questions_chance_alone_shows_nothing_and_what_is_small_is_left_out():
    rng = np.random.default_rng(6)
    over = 0
    for _ in range(400):
        asked = [large("a", float(p)) for p in rng.random(100)]
        over += bool(beyond_chance(asked))
    assert over <= 12
    small = replace(large("a", 1e-9), size=0.0)
    assert beyond_chance([small, large("c", 0.5)]) == []


def test_a_gain_that_is_another_from_a_moment_on_is_told_of_with_its_time_and_size():
    p = problem(7, 4.0 * TOLERANCE * (np.arange(BLOCKS) >= 30))
    left = found(p, "differs")
    assert [s.parameter for s in left] == ["accel.bias.x"]
    assert left[0].size == pytest.approx(2.0, rel=0.1)
    assert "from 900 s on" in left[0].text


def test_what_lasts_two_minutes_and_comes_again_wanders():
    """Of a square wave of four minutes a sum over three neighbours is none."""
    on = (np.arange(BLOCKS) // 4 % 2) * 4.0 * TOLERANCE
    assert ("wanders", "accel.bias.x") in structures(problem(8, on))


def test_of_several_drives_the_one_in_which_a_gain_jumps_is_told():
    p = problem(7, 4.0 * TOLERANCE * (np.arange(BLOCKS) >= 30))
    drive = (np.arange(BLOCKS) >= 24).astype(int)
    start = 30.0 * (np.arange(BLOCKS) % 24)
    p = replace(p, table=replace(p.table, drive=drive, start_s=start))
    [left] = found(p, "differs")
    assert "from 180 s of drive 2 on" in left.text


def neighbours(x):
    return np.sum(x[:, 1:] * x[:, :-1], axis=1)


def test_a_share_of_orders_is_that_of_all_orders():
    s = np.random.default_rng(12).standard_t(4, 8)
    sizes = np.sort(neighbours(s[np.array(list(permutations(range(8))))]))
    for share in (0.3, 0.03, 0.003):
        at = sizes[-round(share * len(sizes))]
        order = next(o for o in permutations(range(8)) if neighbours(s[[list(o)]])[0] == at)
        got = _share_of_orders(s[list(order)], np.eye(8), neighbours)
        assert got == pytest.approx(np.mean(sizes >= at), rel=0.35)


def test_evidence_that_one_order_in_a_million_has_is_not_lost():
    """All ones before all others: two orders of all that differ."""
    s = np.repeat([1.0, -1.0], 12)
    got = _share_of_orders(s, np.eye(24), neighbours)
    assert got == pytest.approx(2.0 / comb(24, 12), rel=0.6)


def test_segments_that_differ_by_chance_have_even_chances():
    """Of 200 questions to noise a tenth has a chance below a tenth."""
    rng = np.random.default_rng(13)
    waves = np.exp(2j * np.pi * np.outer(np.arange(24), np.arange(3, 13) / 24))
    p = [_share_of_orders(rng.standard_t(4, 24), waves, lambda z: np.abs(z).max(axis=1))
         for _ in range(200)]  # fmt: skip
    assert 8 <= np.sum(np.array(p) < 0.1) <= 34
    assert np.median(p) == pytest.approx(0.5, abs=0.12)


def test_what_can_never_look_large_takes_no_chance_from_what_can():
    """A value that is known well is small and sure: it is no attempt at a false report."""
    there = large("a", 1e-3, 1e-3)
    known = [replace(large("c", 0.5, 1e-12), size=0.1)] * 1000
    open_ = [replace(large("c", 0.5), size=0.1)] * 1000
    assert beyond_chance([there, *known]) == [there.structure]
    assert beyond_chance([there, *open_]) == []


def test_of_what_is_reported_one_in_a_hundred_is_false():
    """Half of the questions show nothing, of which half may look large once in a thousand times."""
    rng, false, reported = np.random.default_rng(7), 0, 0
    for _ in range(2000):
        asked = []
        for i in range(60):
            limit = 3.29 if i % 2 else 0.0
            z = abs(rng.standard_normal() + (6.0 if i < 3 else 0.0))
            p, rare = 2.0 * norm.sf(z), min(1.0, 2.0 * float(norm.sf(limit)))
            asked.append(Answer(str(i), z, limit, p, "", shown=z, rare=rare))
        told = [int(s.signal) for s in beyond_chance(asked)]
        false, reported = false + sum(i >= 3 for i in told), reported + len(told)
    assert reported > 5000
    assert false / reported < 0.013
