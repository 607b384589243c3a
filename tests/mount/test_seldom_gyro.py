"""A gyroscope that sends seldom lets the vertical walk, and noise in a turn rate is no bend."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from imucald.core.samples import GRAVITY, Series
from imucald.motion.column_ticks import ticks_from_samples
from imucald.mount.contradictions import Contradictions, StandingFault
from imucald.mount.even_signals import sampling_walk
from imucald.mount.hand_moves import FORCE, TurnedAlone
from imucald.mount.signal_blocks import ACCEL_GAP, BLOCK_TICKS, SignalBlockMaker
from mount_settings import joint_settings
from signal_block import block

Array = NDArray[np.float64]

SPACING = 0.24
SHAKING = 0.1
"""What the samples hold of quick shaking [rad/s], rms."""


def test_the_walk_of_white_samples_is_their_variance_times_the_time_between_them() -> None:
    rng = np.random.default_rng(1)
    times = SPACING * np.arange(4000) + 0.02 * rng.uniform(size=4000)
    sizes = np.array([0.1, 0.05, 0.0])
    rates = sizes * rng.standard_normal((4000, 3))
    walk = sampling_walk(times, rates, np.ones(4000), ACCEL_GAP)
    assert np.diag(walk) == pytest.approx(sizes**2 * SPACING, rel=0.1)
    summed = np.cumsum(rates * np.gradient(times)[:, None], axis=0)
    apart = summed[25::25] - summed[:-25:25]  # 6 s
    assert np.var(apart[:, 0]) == pytest.approx(walk[0, 0] * 25 * SPACING, rel=0.3)


def test_slow_turning_and_means_of_several_samples_make_no_walk() -> None:
    times = SPACING * np.arange(400)
    slow = 0.1 * np.sin(2.0 * np.pi * 0.05 * times)[:, None] * np.ones(3)
    assert np.abs(sampling_walk(times, slow, np.ones(400), ACCEL_GAP)).max() < 1e-6
    rng = np.random.default_rng(2)
    means = 0.1 * rng.standard_normal((400, 3))
    assert not sampling_walk(times, means, np.full(400, 3), ACCEL_GAP).any()
    assert not sampling_walk(times[:2], slow[:2], np.ones(2), ACCEL_GAP).any()


@pytest.mark.parametrize(("spacing", "walks"), [(SPACING, True), (0.1, True), (0.01, False)])
def test_blocks_say_how_far_the_angle_walks(spacing: float, walks: bool) -> None:
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 20.0, spacing)
    force = np.tile([0.0, 0.0, GRAVITY], (len(t), 1))
    samples = {
        "accel": Series(t, force),
        "gyro": Series(t, SHAKING * rng.standard_normal((len(t), 3))),
        "speed": Series(t, np.full(len(t), 10.0)),
    }
    maker, found = SignalBlockMaker(joint_settings()), []
    for row in ticks_from_samples(samples, 0, 200, {}).tolist():
        if maker.push(row):
            found.append(maker.block().rate_walk)
    assert found
    if walks:
        expected = SHAKING**2 * spacing
        assert 0.3 < np.trace(found[-1]) / (3.0 * expected) < 3.0
    else:
        assert not found[-1].any()


def bends(noise: float, sign: float) -> tuple[StandingFault, ...]:
    """Faults after ten minutes of gentle bends at 20 m/s, with noise in the turn rate [rad/s]."""
    rng, watch = np.random.default_rng(4), Contradictions(joint_settings())
    t = 0.1 * np.arange(BLOCK_TICKS)
    for _ in range(90):
        r = 0.1 * np.sin(0.5 * t + rng.uniform(0.0, 6.0)) * rng.uniform(0.1, 1.0)
        force = np.column_stack([np.zeros(BLOCK_TICKS), sign * 20.0 * r, np.full(BLOCK_TICKS, 9.8)])
        force[:, 1] += 0.1 * rng.standard_normal(BLOCK_TICKS)
        seen = r + noise * rng.standard_normal(BLOCK_TICKS)
        p = block(force=force, speed=np.full(BLOCK_TICKS, 20.0))
        watch.take_block(p, seen, True, np.eye(3), 0.0, False, 0.0)
    return watch.faults


def test_noise_of_the_turn_rate_is_no_bend_that_the_force_contradicts() -> None:
    assert bends(noise=0.2, sign=1.0) == ()


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_force_to_the_wrong_side_is_still_a_contradiction(noise: float) -> None:
    assert bends(noise, sign=-1.0) == (StandingFault.FORCE_TURNS,)
    assert bends(noise, sign=1.0) == ()


def straight(noise: float, is_stated: bool) -> tuple[StandingFault, ...]:
    """Faults after ten minutes of straight road at 20 m/s; noise of samples that come seldom."""
    rng, watch = np.random.default_rng(5), Contradictions(joint_settings())
    for k in range(90):
        rate, walk = shaken(rng, noise)
        force = 0.1 * rng.standard_normal((BLOCK_TICKS, 3)) + [0.0, 0.0, GRAVITY]
        stated = walk if is_stated else np.zeros((3, 3))
        speed = np.full(BLOCK_TICKS, 20.0)
        p = block(0.1 * BLOCK_TICKS * k, force=force, rate=rate, rate_walk=stated, speed=speed)
        watch.take_block(p, rate[:, 2], True, np.eye(3), 0.0, False, 0.0)
    return watch.faults


def shaken(rng: np.random.Generator, noise: float) -> tuple[Array, Array]:
    """A block of rates (N, 3) between samples of white noise [rad/s], and how they walk."""
    times = SPACING * np.arange(-1, 29)
    samples = noise * rng.standard_normal((len(times), 3))
    ticks = 0.1 * np.arange(BLOCK_TICKS)
    rate = np.column_stack([np.interp(ticks, times, samples[:, i]) for i in range(3)])
    return rate, sampling_walk(times, samples, np.ones(len(times)), ACCEL_GAP)


def test_noise_that_lines_between_samples_hide_is_no_bend_either() -> None:
    wrong = straight(0.06, is_stated=False)
    assert StandingFault.FORCE_TURNS in wrong, "nothing is tested otherwise"
    assert straight(0.06, is_stated=True) == ()


def turns_alone(noise: float, is_stated: bool) -> int:
    """How often in an hour of straight road a gyroscope is found to turn by itself."""
    rng, alone, found = np.random.default_rng(6), TurnedAlone(), 0
    for _ in range(560):
        rate, walk = shaken(rng, noise)
        by = FORCE.with_gyro_errors(float(walk[2, 2])) if is_stated else FORCE
        ok = np.ones(BLOCK_TICKS, dtype=bool)
        found += alone.take_rates(rate[:, 2], np.zeros(BLOCK_TICKS), ok, by) != 0.0
    return found


def test_a_gyroscope_that_shakes_between_its_samples_turns_no_sensor() -> None:
    assert turns_alone(0.15, is_stated=False) > 10, "nothing is tested otherwise"
    assert turns_alone(0.15, is_stated=True) == 0


def test_a_hand_that_turns_a_sensor_is_seen_beside_a_little_shaking() -> None:
    rng, alone = np.random.default_rng(7), TurnedAlone()
    rate, walk = shaken(rng, 0.02)
    t = 0.1 * np.arange(BLOCK_TICKS)
    rate[:, 2] += np.where((t > 2.9) & (t < 3.9), math.radians(30.0), 0.0)
    by, ok = FORCE.with_gyro_errors(float(walk[2, 2])), np.ones(BLOCK_TICKS, dtype=bool)
    turned = alone.take_rates(rate[:, 2], np.zeros(BLOCK_TICKS), ok, by)
    assert math.degrees(turned) == pytest.approx(30.0, abs=5.0)
