"""How sure a direction of travel is: it covers, and is never wrong by 180 deg without a word."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gait import CARRYINGS, Carrying, walk
from imucald.travel_direction.certainty import (
    AHEAD_KNOWN,
    axis_std,
    edge_log_odds,
    probability,
    sign_log_odds,
)
from imucald.travel_direction.direction import TravelDirection, TravelState

BY_NAME = {carrying.name: carrying for carrying in CARRYINGS}


def steps_of(w):
    travel, steps = TravelDirection(), []
    for i, t in enumerate(w.t.tolist()):
        travel.gyro(t, w.gyro[i].tolist())
        travel.mag(t, w.mag[i].tolist())
        step = travel.accel(t, w.accel[i].tolist())
        if step is not None:
            steps.append((step, travel.state(t)))
    return steps


def judged(w):
    """Error, deviation, ambiguous of each step."""
    found = []
    for step, state in steps_of(w):
        if step.alternative is None:
            continue
        course = float(np.interp(step.t - 0.5 * step.duration, w.t, w.course))
        error = abs(math.remainder(step.alternative - course, 2.0 * math.pi))
        found.append((error, step.deviation, step.ambiguous))
        assert (state is TravelState.AMBIGUOUS) == step.ambiguous
        assert 0.5 <= step.ahead <= 1.0
    return np.array(found)


@pytest.mark.parametrize("name", sorted(BY_NAME))
def test_a_wrong_sign_is_reported_and_deviations_cover(name):
    """Seeds that no constant was looked at with."""
    table = np.vstack([judged(walk(BY_NAME[name], s, seed=seed, seconds=60.0))
                       for s, seed in ((0.9, 71), (1.3, 72), (1.7, 73))])  # fmt: skip
    is_sure = table[:, 2] == 0.0
    assert np.mean((table[:, 0] > 0.5 * math.pi) & is_sure) < 0.02
    if is_sure.any():
        assert np.mean((table[:, 0] < 1.96 * table[:, 1])[is_sure]) > 0.9


def test_a_phase_that_shows_nothing_is_ambiguous():
    """Forward in step with a quarter period beside the lead: both senses are as likely."""
    odd = Carrying("odd", (85.0, 0.0, 180.0), 1.5, 2.5, 0.0, 205.0)
    table = judged(walk(odd, 1.3, seed=5, seconds=60.0))
    assert np.mean(table[10:, 2]) > 0.8


def test_the_ratio_is_that_of_the_phases():
    """Von Mises phases: measured against brute likelihoods."""
    kappa = 1.0 / math.radians(30.0) ** 2
    for off in (0.0, 0.5, 1.2, 1.5):
        ratio = kappa * math.cos(off) - kappa * math.cos(off + math.pi)
        assert sign_log_odds(math.cos(off), 0.0) == pytest.approx(ratio)
    assert probability(0.0) == 0.5
    assert probability(sign_log_odds(1.0, 0.0)) > AHEAD_KNOWN
    assert probability(sign_log_odds(1.0, 4.0)) < AHEAD_KNOWN  # an arm that swings widely


def test_the_edge_counts_only_where_the_screen_is_looked_at():
    assert edge_log_odds(1.0, 0.9, 0.0) == pytest.approx(math.log(9.0))
    assert edge_log_odds(-1.0, 0.9, 0.0) == pytest.approx(-math.log(9.0))
    assert edge_log_odds(1.0, 0.1, 0.0) == 0.0
    assert edge_log_odds(1.0, 0.9, 1.0) < 0.3


def test_the_deviation_of_an_axis_is_that_of_its_steps():
    rng = np.random.default_rng(1)
    angles = rng.normal(0.0, 0.2, 40_000)
    agreement = abs(np.mean(np.exp(2j * angles)))
    assert axis_std(float(agreement), 1.0) == pytest.approx(0.2, rel=0.03)
    assert axis_std(float(agreement), 16.0) == pytest.approx(0.1, rel=0.03)  # four share
    assert axis_std(0.0, 1.0) == pytest.approx(math.pi / 2.0)


def test_without_a_gyroscope_nothing_is_claimed():
    w = walk(BY_NAME["in front, tilted"], seconds=20.0, seed=1)
    travel = TravelDirection()
    for i, t in enumerate(w.t.tolist()):
        travel.mag(t, w.mag[i].tolist())
        travel.accel(t, w.accel[i].tolist())
    assert travel.last is not None
    assert (travel.last.deviation, travel.last.ahead, travel.last.ambiguous) == (None, None, False)
