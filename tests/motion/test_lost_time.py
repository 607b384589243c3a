"""Time that stood still while samples came: told from samples that come late or together."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imucald.core.samples import Series
from imucald.motion.lost_time import LostTime
from sound_signals import batched, late, sent_again

RATES = (10.0, 50.0, 100.0, 400.0)
SOUND = {"late": late, "pairs": batched(2), "fives": batched(5),
         "twice": sent_again(2), "three times": sent_again(3)}  # fmt: skip


def losses(stamps):
    """Time and size of what is found lost, of stamps on a stream that never goes back."""
    watch, highest, found = LostTime(), stamps[0], []
    for stamp in stamps:
        t = max(highest, float(stamp))
        if lost := watch.take_time_step(t - highest):
            found.append((t, lost))
        highest = t
    return found


def stamps_of(rate, seconds=120.0):
    return np.arange(0.0, seconds, 1.0 / rate)


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("back", [0.25, 0.5, 0.95])
def test_a_clock_set_back_is_found_as_soon_as_time_goes_on(rate, back):
    t = stamps_of(rate)
    t[t >= 60.0] -= back
    ((when, lost),) = losses(t)
    assert when == pytest.approx(60.0, abs=1.5 / rate)
    assert lost == pytest.approx(back, abs=1.5 / rate)


def test_it_is_seen_while_time_stands():
    watch = LostTime()
    for _ in range(200):
        assert watch.take_time_step(0.01) == 0.0
        assert watch.standing == 0.0
    seen = []
    for _ in range(20):
        assert watch.take_time_step(0.0) == 0.0
        seen.append(watch.standing)
    assert seen[4] == 0.0
    assert seen[-1] == pytest.approx(0.2)
    assert watch.take_time_step(0.01) == pytest.approx(0.2)
    assert watch.standing == 0.0


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("edit", SOUND)
def test_sound_stamps_lose_nothing(rate, edit):
    t = stamps_of(rate)
    t = t[: len(t) // 10 * 10]
    edited = SOUND[edit](Series(t, np.zeros((len(t), 3))), np.random.default_rng(1)).t
    assert losses(edited) == []


@pytest.mark.parametrize("rate", RATES)
def test_samples_that_are_late_together_lose_nothing(rate):
    """A reader that stalls for up to 0.45 s stamps all that waited when it goes on."""
    rng, t = np.random.default_rng(2), stamps_of(rate)
    for start in np.arange(10.0, 110.0, 7.3):
        waited = (t >= start) & (t < start + rng.uniform(0.05, 0.45))
        if waited.any():
            t[waited] = t[waited].max() + 1.0 / rate + 1e-5 * np.arange(waited.sum())
    assert losses(t) == []


@pytest.mark.parametrize("rate", RATES)
def test_stamps_out_of_order_and_samples_that_are_missing_lose_nothing(rate):
    rng, t = np.random.default_rng(3), stamps_of(rate)
    assert losses(t + rng.exponential(min(2.0 / rate, 0.02), len(t))) == []
    assert losses(t[rng.random(len(t)) > 0.2]) == []


def test_another_rate_is_no_lost_time():
    for faster in (2.0, 4.0):
        steps = np.concatenate([np.full(2000, 0.02), np.full(2000, 0.02 / faster)])
        assert losses(np.cumsum(steps)) == []


def test_nothing_is_said_before_the_cycle_is_known():
    watch = LostTime()
    assert [watch.take_time_step(0.0) for _ in range(50)] == [0.0] * 50
    assert not watch.standing
    assert watch.take_time_step(0.01) == 0.0
    assert math.isfinite(watch.standing)
