"""Over-dispersions of many questions that share a law."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import t as student

from imucald.diagnosis.fit.chance import moderated

QUESTIONS, FREE, DRAWS = 100, 7.0, 400


def drawn(rng: np.random.Generator, prior: float, common: float = 2.0):
    """True over-dispersions by Smyth's law, and what as many degrees of freedom show of them."""
    true = common * prior / rng.chisquare(prior, QUESTIONS)
    return true, true * rng.chisquare(FREE, QUESTIONS) / FREE


@pytest.mark.parametrize("prior", [4.0, 15.0, 60.0])
def test_a_chance_is_as_often_reached_as_it_says_and_power_grows(prior):
    rng = np.random.default_rng(1)
    few, seen, seen_alone = 0, 0, 0
    level = 1e-3
    for _ in range(DRAWS):
        true, shown = drawn(rng, prior)
        over, free = moderated(shown, np.full(QUESTIONS, FREE), 1e9)
        noise = np.sqrt(true) * rng.standard_normal(QUESTIONS)
        few += int((2.0 * student.sf(np.abs(noise) / np.sqrt(over), free) < level).sum())
        there = np.abs(noise + 8.0)
        seen += int((2.0 * student.sf(there / np.sqrt(over), free) < level).sum())
        seen_alone += int((2.0 * student.sf(there / np.sqrt(shown), FREE) < level).sum())
    expected = level * QUESTIONS * DRAWS
    assert few < expected + 4.0 * np.sqrt(expected)
    assert few > 0.3 * expected
    assert seen > 1.2 * seen_alone


def test_where_all_are_alike_the_common_one_counts_for_all():
    rng = np.random.default_rng(2)
    shown = 3.0 * rng.chisquare(FREE, 2000) / FREE
    over, free = moderated(shown, np.full(2000, FREE), 50.0)
    assert over == pytest.approx(np.full(2000, 3.0), rel=0.35)
    assert free == pytest.approx(np.full(2000, 50.0))


def test_no_more_is_borrowed_than_the_segments_have():
    rng = np.random.default_rng(3)
    _, shown = drawn(rng, 60.0)
    _, free = moderated(shown, np.full(QUESTIONS, FREE), 11.0)
    assert (free <= 11.0).all()
    over, free = moderated(shown, np.full(QUESTIONS, FREE), FREE)
    assert over == pytest.approx(shown)
    assert free == pytest.approx(np.full(QUESTIONS, FREE))


def test_few_questions_have_no_law():
    shown = np.array([1.0, 9.0])
    over, free = moderated(shown, np.full(2, FREE), 1e9)
    assert over.tolist() == shown.tolist()
    assert free.tolist() == [FREE, FREE]


def test_what_differs_without_bound_is_left_to_itself():
    shown = np.exp(np.random.default_rng(4).standard_normal(QUESTIONS) * 50.0)
    over, _ = moderated(shown, np.full(QUESTIONS, FREE), 1e9)
    assert over == pytest.approx(shown, rel=0.02)
