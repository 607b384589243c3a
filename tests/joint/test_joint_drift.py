"""A zero of the accelerometer that drifts, on drives in closed form and on simulated ones."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from imucald.core.rotations import rotation_from_vector
from imucald.core.samples import Series
from imucald.motion.column_ticks import ticks_from_samples
from imucald.mount.contradictions import StandingFault
from imucald.mount.estimate import MountState
from imucald.mount.estimator import JointEstimator
from imucald.mount.estimator_settings import LEVEL
from imucald.mount.joint.drift import NAMED, NONE, Drift
from imucald.mount.joint.evidence import Block, Evidence
from imucald.mount.joint.state import Priors
from imucald.simulation import random_model, simulate
from imucald.simulation.drive import Drive
from joint.planar_drive import ROTATION, Sensor, blocks
from mount_settings import joint_settings

LEVEL_ROADS = Priors(crown=(0.0, 0.002), slope=0.002)
USUAL_ROADS = Priors(crown=(0.0, 0.002))
FROM_S, WRONG = 200.0, 0.5
GOOD = {MountState.USABLE, MountState.FINE}


def held(made: list[Block], priors: Priors = LEVEL_ROADS) -> Evidence:
    evidence = Evidence(priors)
    for block in made:
        evidence.add_block(block)
        evidence.solve_when_due()
        _ = evidence.drift  # asked block by block, as the estimator does
    return evidence


def drifting(minutes: float, rate: np.ndarray) -> list[Block]:
    """A sound sensor whose zero drifts by (3,) [m/s^2 a second] in sensor axes."""
    out = []
    for k, b in enumerate(blocks(minutes, Sensor())):
        t = 6.4 * k + 0.1 * np.arange(64)
        out.append(b._replace(force=b.force + np.maximum(t - FROM_S, 0.0)[:, None] * rate))
    return out


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("rate", [0.001, 0.003])
def test_what_a_zero_has_drifted_by_is_found_within_its_deviation(axis: int, rate: float) -> None:
    minutes = FROM_S / 60.0 + 0.45 / rate / 60.0
    made = drifting(minutes, rate * np.eye(3)[axis])
    evidence = held(made)
    found, true = evidence.drift, rate * (6.4 * len(made) - FROM_S)
    assert found.log_odds > 0.0
    assert found.is_named
    off = found.size - true * ROTATION[:, axis]
    assert off @ np.linalg.solve(found.covariance, off) < 25.0
    square = np.diag(found.covariance) + found.size**2
    np.testing.assert_allclose(found.variance(), square, rtol=1e-3)


@pytest.mark.parametrize("axis", range(2))
def test_a_drift_shows_before_it_misleads_where_bends_are_gentle(axis: int) -> None:
    evidence, rate = Evidence(Priors(crown=(0.0, 0.006))), 0.003
    for k, block in enumerate(blocks(8.0, Sensor(), bends=0.4)):
        off = rate * np.maximum(6.4 * k + 0.1 * np.arange(64) - FROM_S, 0.0)
        force = block.force + off[:, None] * ROTATION.T[:, axis]
        evidence.add_block(block._replace(force=force))
        evidence.solve_when_due()
        if off[-1] > WRONG:
            break
    found = evidence.drift
    assert found.is_named or np.sqrt(found.variance()).max() > LEVEL[0]


def test_a_sound_zero_adds_nothing_to_the_deviation() -> None:
    found = held(blocks(12.0, Sensor(zero=np.array([0.2, -0.15, 0.1])))).drift
    assert found.log_odds < -5.0
    assert np.sqrt(found.variance()).max() < 0.02


def test_a_warm_up_that_is_certain_is_no_fault_and_makes_none_likely_on_other_axes() -> None:
    up, out = ROTATION.T @ np.array([0.0, 0.0, 1.0]), []
    for k, b in enumerate(blocks(12.0, Sensor())):
        warmed = 0.1 * -np.expm1(-(6.4 * k + 0.1 * np.arange(64)) / 300.0)
        out.append(b._replace(force=b.force + warmed[:, None] * up))
    found = held(out).drift
    assert found.log_odds < 0.0
    assert np.sqrt(found.variance())[:2].max() < 0.03
    assert np.sqrt(found.variance())[2] == pytest.approx(0.07, abs=0.02), "it is in the deviation"


def test_a_zero_of_the_gyroscope_that_changes_is_no_drift_of_the_accelerometer() -> None:
    taken, out = np.array([0.004, -0.003, 0.002]), []
    for k, b in enumerate(blocks(10.0, Sensor())):
        zero = taken if k < 30 else np.zeros(3)  # what is taken off gets better at a rest
        out.append(b._replace(rate=b.rate - zero, rate_zero=zero))
    assert not held(out).drift.is_named


@pytest.mark.parametrize("axis", range(3))
def test_a_mount_that_creeps_is_no_drift_of_the_accelerometer(axis: int) -> None:
    out = []
    for k, b in enumerate(blocks(12.0, Sensor())):
        angle = np.radians(30.0 / 3600.0) * max(6.4 * k - FROM_S, 0.0)
        R = rotation_from_vector(angle * np.eye(3)[axis])
        out.append(b._replace(force=b.force @ R.T, rate=b.rate @ R.T))
    assert held(out).drift.log_odds < -5.0


def test_a_drift_goes_on_where_evidence_begins_again() -> None:
    rate = np.array([0.001, 0.0, 0.0])
    made = drifting(10.0, rate)
    before, since = held(made[:60]), made[60:]  # 0.18 m/s^2: not named yet
    assert not before.drift.is_named
    forgetful, going_on = (
        Evidence(LEVEL_ROADS),
        Evidence(LEVEL_ROADS, past=before.in_sensor_axes(before.drift)),
    )
    for block in since:
        for evidence in (forgetful, going_on):
            evidence.add_block(block)
            evidence.solve_when_due()
    true = rate[0] * (6.4 * len(made) - FROM_S)
    assert not forgetful.drift.is_named
    assert going_on.drift.is_named
    assert np.linalg.norm(going_on.drift.size) == pytest.approx(true, abs=0.1)


def test_a_sound_past_makes_no_drift_of_evidence_that_begins_again() -> None:
    made = blocks(12.0, Sensor())
    before = held(made[:60])
    evidence = Evidence(LEVEL_ROADS, past=before.in_sensor_axes(before.drift))
    for block in made[60:]:
        evidence.add_block(block)
        evidence.solve_when_due()
    assert evidence.drift.log_odds < -5.0


def test_blocks_of_which_nothing_may_be_used_are_passed_over() -> None:
    made = drifting(8.0, np.array([0.003, 0.0, 0.0]))
    for k in range(20, 24):
        made[k] = made[k]._replace(use=np.zeros(64, dtype=bool))
    found = held(made).drift
    assert found.is_named


def test_a_guess_is_put_back_before_the_rates_zero_is_taken_off() -> None:
    zero, guess = np.array([0.01, -0.02, 0.03]), np.array([0.02, -0.05, 0.1])
    sound, guessed = Evidence(LEVEL_ROADS), Evidence(LEVEL_ROADS)
    for k, b in enumerate(blocks(4.0, Sensor())):
        sound.add_block(b)
        raw = b.rate + zero
        known = k >= 10
        taken = zero if known else guess
        if k == 10:
            guessed.subtract_rate_zero(zero)
        guessed.add_block(Block(b.force, raw - taken, b.speed, b.use, known, taken))
    one, other = sound.solve(), guessed.solve()
    assert one is not None
    assert other is not None
    np.testing.assert_allclose(other.force, one.force, atol=1e-9)
    np.testing.assert_allclose(other.rate, one.rate, atol=1e-9)


def test_a_drift_is_named_where_it_is_certain_and_large() -> None:
    size, covariance = np.array([NAMED + 0.01, 0.0, 0.0]), 0.01 * np.eye(3)
    assert Drift(0.1, size, covariance).is_named
    assert not Drift(-0.1, size, covariance).is_named
    assert not Drift(9.0, 0.9 * size, covariance).is_named
    assert not NONE.is_named
    assert NONE.variance().max() == 0.0


@cache
def drive() -> Drive:
    return simulate(random_model(976_001, standing_first=True), 976_001, 12.0)


ASKS_FOR_DRIFT = "bends, to decide whether the accelerometer's zero drifts ("


@pytest.mark.slow
@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("rate", [0.001, 0.003])
def test_no_value_is_good_while_a_drifting_zero_has_made_it_wrong(axis: int, rate: float) -> None:
    made = drive()
    samples = dict(made.samples)
    series = samples["accel"]
    values = series.values.copy()
    values[:, axis] += rate * np.maximum(series.t - FROM_S, 0.0)
    samples["accel"] = Series(series.t, values)
    joint, was_good, named_at = JointEstimator(joint_settings()), False, math.inf
    reasons: set[str] = set()
    for k, row in enumerate(ticks_from_samples(samples, 0, 7200).tolist()):
        joint.step(row)
        off = rate * (0.1 * k - FROM_S)
        was_good = was_good or (joint.state in GOOD and off < 0.0)
        if off > 0.0 and joint.state is not MountState.FINE and not joint.faults:
            reasons |= set(joint.estimate().waiting_for.values())
        assert joint.state not in GOOD or off < WRONG, off
        if joint.faults:
            named_at = min(named_at, off)
    assert was_good
    is_reason = any(text.startswith(ASKS_FOR_DRIFT) for text in reasons)
    assert rate > 0.001 or is_reason or named_at < 0.25, "a slow one is a reason or is named early"
    assert StandingFault.ACCEL_DRIFT in joint.estimate().faults


@pytest.mark.slow
def test_a_drift_is_named_before_the_next_bend_makes_a_move_of_it() -> None:
    """A straight road hid it; the bend at its end looked like a tilt, and evidence began again."""
    samples = dict(simulate(random_model(994_007), 994_007, 15.0).samples)
    t, values = samples["accel"].t, samples["accel"].values.copy()
    values[:, 0] += 0.002 * np.maximum(t - 250.0, 0.0)
    samples["accel"] = Series(t, values)
    joint, was_good = JointEstimator(joint_settings()), False
    for k, row in enumerate(ticks_from_samples(samples, 0, 6000).tolist()):
        joint.step(row)
        was_good = was_good or (joint.state in GOOD and k > 3000)
        assert joint.state not in GOOD or 0.002 * (0.1 * k - 250.0) < WRONG
    assert was_good


def test_a_zero_of_the_rate_that_was_guessed_badly_is_no_drift() -> None:
    """In the bends of a car park the guess from driving is off by some degrees a second."""
    evidence, off, odds = Evidence(USUAL_ROADS), ROTATION.T @ np.array([0.0, 0.0, 0.1]), []
    for b in blocks(6.0, Sensor()):
        guess = b._replace(rate=b.rate + off, is_rate_known=False, turn_zero_std=0.1)
        evidence.add_block(guess)
        evidence.solve_when_due()
        odds.append(evidence.drift.log_odds)
    assert max(odds) < -3.0


def test_a_tilt_that_lost_samples_hide_within_a_block_is_no_drift() -> None:
    """The vehicle rolls while nothing comes; the samples before the hole know nothing of it."""
    across, tilt, made = ROTATION.T @ np.array([0.0, 0.35, 0.0]), 0.0, blocks(8.0, Sensor())
    for k, b in enumerate(made):
        tilts, use = np.full(64, tilt), np.ones(64, dtype=bool)
        if k > 40 and k % 4 == 0:
            tilt = 1.0 - tilt
            tilts[31:], use[29:33] = tilt, False
        made[k] = b._replace(force=b.force + tilts[:, None] * across, use=use)
    assert max(held(made[:n], USUAL_ROADS).drift.log_odds for n in (46, 54, 62, 70)) < -3.0
