"""Delays that follow stamps, or step: by hand-made speeds, and put into simulated drives."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from imucald.core.samples import Series
from imucald.diagnosis.fit.chance import beyond_chance
from imucald.diagnosis.left_over.delay_course import (
    Pieces,
    delay_course,
    off_cycle,
    settled,
    stepping,
)
from imucald.diagnosis.result import WANDERS
from imucald.diagnosis.search.state import State
from imucald.diagnosis.signals import drive_of
from imucald.simulation import random_model, simulate

BLOCKS, ROWS = 30, 300
MAY = 0.08


# stamps ------------------------------------------------------------------------------------------


def test_an_even_cycle_is_not_left_by_lost_frames_nor_by_a_pause():
    t = np.delete(0.5 * np.arange(400), [7, 90, 91, 300])
    assert off_cycle(t) == pytest.approx(0.0, abs=1e-9)
    t[200:] += 123.3
    assert off_cycle(t) == pytest.approx(0.0, abs=0.2)


def test_a_clock_that_runs_evenly_and_wrong_leaves_no_cycle():
    assert off_cycle(1.0003 * np.arange(1000.0)) == pytest.approx(0.0, abs=1e-9)


def test_stamps_that_are_set_leave_their_cycle_by_as_much():
    t = np.arange(1000.0)
    late = off_cycle(t + 0.3 * (t >= 500.0))
    assert late[500] - late[499] == pytest.approx(0.3, abs=0.01)


# hand-made speeds --------------------------------------------------------------------------------


def made(rng, late=0.0, noise=0.1, cycle=1.0, period=61.0):
    """Fifteen minutes of a speed that is `late` (s, or a function of time) by its stamps, which
    leave an even cycle by 0.3 s to either side, and is truly sampled at these stamps otherwise."""
    at = np.arange(0.0, BLOCKS * ROWS * 0.1, cycle)
    x = 0.3 * np.sin(2.0 * np.pi * at / period + rng.uniform(0.0, 6.0))
    waves = [(a, w, rng.uniform(0.0, 6.0)) for a, w in ((5.0, 0.11), (2.0, 0.37), (0.7, 0.9))]

    def speed(t):
        return 15.0 + sum(a * np.sin(w * t + phase) for a, w, phase in waves)

    own = late(at, x) if callable(late) else late
    # Errors that last for a while, as of a road: another in each segment.
    shown = speed(at - own) + noise * rng.standard_normal(len(at))
    shown += noise * rng.standard_normal(BLOCKS)[(at // 30.0).astype(int)] * np.sin(0.2 * at)
    edges = (np.arange(BLOCKS)[:, None] * ROWS + np.arange(ROWS + 1)) * 0.1
    since = edges - edges[:, :1]
    sums = np.stack([speed(edges) - speed(edges[:, :1]), 9.8 * since, 0.1 * since**2])
    every = np.ones(len(at), dtype=bool)
    return Pieces(at, shown, every, at / 1000.0, np.column_stack([x, x]), edges, sums), x


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_by_how_much_a_delay_follows_its_stamps_is_found_with_its_deviation(share):
    rng = np.random.default_rng(1)
    off = []
    for _ in range(40):
        pieces, x = made(rng, lambda t, x: share * x + 0.1 + 2e-4 * t)
        found = settled([pieces], [x])
        off.append((found.value - share) * found.sigma / abs(found.value))
    assert np.std(off) == pytest.approx(1.0, abs=0.35)
    assert np.mean(off) == pytest.approx(0.0, abs=0.6)


def test_chances_of_stamps_are_no_smaller_than_they_say():
    """Senders that are late themselves, in 250 drives."""
    rng = np.random.default_rng(2)
    p = [settled([one], [x]).p for one, x in (made(rng) for _ in range(250))]
    assert np.mean(np.array(p) < 0.05) < 0.08
    assert np.mean(np.array(p) < 0.01) < 0.025


def test_chances_of_a_step_are_no_smaller_than_they_say():
    rng = np.random.default_rng(3)
    p = [stepping([made(rng, lambda t, _: 3e-4 * t)[0]], MAY)[0].p for _ in range(100)]
    assert np.mean(np.array(p) < 0.05) < 0.1


def test_a_step_is_found_with_its_moment_and_size_beside_an_even_growth():
    rng = np.random.default_rng(4)
    pieces, _ = made(rng, lambda t, _: 3e-4 * t + 0.3 * (t >= 510.0))
    (step,) = stepping([pieces], MAY)
    assert step.p < 1e-4
    assert step.is_large
    assert step.structure.size * MAY == pytest.approx(0.3, abs=0.05)
    assert "by 0.3 s at 510 s" in step.structure.text


# simulated drives --------------------------------------------------------------------------------


@cache
def sound():
    model = random_model(5)
    return model, dict(simulate(model, 5, 20.0).samples)


def left_in(put=None):
    model, samples = sound()
    samples = dict(samples)
    if put is not None:
        samples["speed"] = put(samples["speed"].t, samples["speed"].values)
    state = State([drive_of(samples)], model, model, {})
    return beyond_chance(delay_course(state.evaluated(), state))


def wander(t):
    return 0.4 * np.sin(2.0 * np.pi * t / 97.0)


@pytest.mark.slow
def test_stamps_that_wander_are_seen():
    (left,) = left_in(lambda t, v: Series(t + wander(t), v))
    assert left.kind == WANDERS
    assert "even cycle" in left.text


@pytest.mark.slow
def test_a_sender_that_wanders_and_stamps_rightly_is_not_reported():
    assert left_in(lambda t, v: Series(t + wander(t), np.interp(t + wander(t), t, v))) == []


@pytest.mark.slow
def test_a_speed_that_is_late_from_some_moment_on_with_even_stamps_is_seen():
    def put(t, v):
        return Series(t, np.interp(t - 0.4 * (t > t[0] + 500.0), t, v))

    (left,) = left_in(put)
    assert "changes by 0.4" in left.text or "changes by 0.3" in left.text


@pytest.mark.slow
def test_a_sound_drive_and_one_whose_clock_runs_evenly_wrong_leave_nothing():
    assert left_in() == []
    assert left_in(lambda t, v: Series(t + 2e-4 * (t - t[0]), v)) == []
