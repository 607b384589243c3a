"""The estimator's kernels against numpy: the same bits, or the same refusal."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from recorded_calls import needs_kernels

from both_ways import agree, spiked
from imucald.core.samples import GRAVITY
from imucald.mount import block_sums as block_sums_module
from imucald.mount import (
    contradictions,
    creep,
    evidence_gravity,
    fusion,
    large_change,
    road_segments,
    shift,
    steering,
    vertical_block,
)
from imucald.mount import evidence_response as response
from imucald.mount import evidence_rows as scores
from imucald.mount import evidence_spectra as spectra
from imucald.mount import gyro_alternatives as alternatives
from imucald.mount.block_sums import block_sums, masked_sums, pair_sums
from imucald.mount.delay import DelaySearch
from imucald.mount.estimator_settings import DelayPrior, EstimatorSettings
from imucald.mount.evidence_rows import GAINS, MAX_REGRESSORS, ROWS
from imucald.mount.gravity_observer import GravityObserver, MotionWindow
from imucald.mount.gravity_step import AGES, GravityStepDetector
from imucald.mount.large_change import TurnedAlone
from imucald.mount.signal_blocks import BLOCK_TICKS, SignalBlock
from imucald.mount.states import Manoeuvres
from signal_block import block

pytestmark = [needs_kernels, pytest.mark.slow]

N = BLOCK_TICKS
LEVEL = np.array([0.0, 0.0, GRAVITY])
MANY = settings(max_examples=120, deadline=None, suppress_health_check=list(HealthCheck))
SEEDS = given(st.integers(0, 2**32 - 1))
BANDS, BINS, MEASURED = spectra.BANDS, spectra.BINS, spectra.MEASURED

Rng = np.random.Generator


def drawn(seed: int) -> tuple[Rng, float]:
    """Random numbers, and which share of numbers is one that arithmetic bears badly."""
    rng = np.random.default_rng(seed)
    return rng, float(rng.choice([0.0, 0.0, 0.0, 0.002, 0.05]))


def flags(rng: Rng, n: int = N) -> np.ndarray:
    return rng.random(n) < rng.choice([0.0, 0.02, 0.5, 0.98, 1.0])


def rotation(rng: Rng) -> np.ndarray:
    found: np.ndarray = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return found


def covariance(rng: Rng, n: int) -> np.ndarray:
    A = rng.normal(size=(n, n)) * 10.0 ** rng.uniform(-3, 1, n)[:, None]
    return np.asarray(A @ A.T + 1e-8 * np.eye(n))


def any_block(rng: Rng, share: float) -> SignalBlock:
    def column(size: float, *more: int) -> np.ndarray:
        return spiked(rng, size * rng.normal(size=(N, *more)), share)

    names = [
        "ok_force",
        "ok_rate",
        "ok_speed",
        "ok_yaw",
        "rest",
        "learn",
        "ok_steering",
        "had_rate",
    ]
    return block(
        force=column(2.0, 3) + LEVEL,
        rate=column(rng.choice([0.01, 0.3]), 3),
        speed=np.round(column(8.0) + 12.0, 2) * rng.choice([0.0, 1.0]),
        accel=column(1.5),
        yaw_rate=column(0.2),
        steering=column(1.0),
        **{name: flags(rng) for name in names},
    )


@SEEDS
@MANY
def test_the_vertical_is_carried_through_a_block(seed: int) -> None:
    rng, share = drawn(seed)
    n = int(rng.choice([N, N, N, 1, 2, 7, 130]))
    p = vertical_block.BlockForces(
        spiked(rng, 0.2 * rng.normal(size=(n, 3)), share),
        0.001 * rng.normal(size=3),
        flags(rng, n),
        spiked(rng, rng.normal(size=(n, 3)) + LEVEL, share),
        None if rng.random() < 0.2 else spiked(rng, rng.normal(size=(n, 3)), share),
        0.1 * rng.normal(size=3),
        flags(rng, n),
        flags(rng, n),
    )
    state = None if rng.random() < 0.3 else rng.normal(size=(3, 4))
    count, weighed = int(rng.integers(0, 60)), bool(rng.random() < 0.7)
    agree(vertical_block.carried, p, state, count, 0.1 / 16.0, weighed)


@SEEDS
@MANY
def test_steps_in_gravity(seed: int) -> None:
    rng, share = drawn(seed)
    blocks = [
        (
            rng.normal(size=(3, 3)),
            spiked(rng, rng.normal(size=(7, 6)) * 10.0 ** rng.uniform(-2, 3), share),
            0.5 * rng.normal(size=(3, 3)),
            rotation(rng),
            bool(rng.random() < 0.5),
            0.001 * rng.random((3, 3)) * (rng.random() < 0.3),
        )
        for _ in range(int(rng.integers(1, 3 * AGES)))
    ]
    ages = rng.integers(1, 90, 8).tolist()

    def steps() -> object:
        detector = GravityStepDetector()
        found = []
        for before, sums, end, R, is_good, walked in blocks:
            detector.follow_walk(walked)
            detector.add(before, sums, end)
            found.append(detector.found(R, is_good))
        return found, detector.history.near(ages), detector.history.both

    agree(steps)


@SEEDS
@MANY
def test_sums_over_the_ticks_of_a_block(seed: int) -> None:
    rng, share = drawn(seed)
    p = any_block(rng, share)
    turn_rate = spiked(rng, 0.2 * rng.normal(size=N), share)
    agree(block_sums, p, turn_rate, p.learn)
    agree(pair_sums, p.accel, turn_rate, p.learn)
    agree(pair_sums, p.accel, turn_rate, p.learn, True)
    agree(masked_sums, p.force, p.learn)
    agree(steering._sums_of, p.steering, p.speed, turn_rate, p.learn)
    agree(evidence_gravity._sums, p, p.speed * 0.1, float(rng.choice([0.0, 5.0, 12.0])))
    late = float(rng.choice([0.0, 0.3, -0.2, 1.2, 0.05]))
    motion = block_sums_module.BlockMotion(
        p.force, p.accel, p.speed * turn_rate, turn_rate, late, 0.1
    )
    agree(block_sums_module._sums, motion, p.learn)
    agree(alternatives.gyro_energies, p.accel, p.force[:, 1], p.rate, p.speed, rotation(rng), 0.9)


@SEEDS
@MANY
def test_pairs_of_signals(seed: int) -> None:
    rng, share = drawn(seed)
    p = any_block(rng, share)
    turn_rate = spiked(rng, 0.2 * rng.normal(size=N), share)
    agree(
        contradictions._sums_of_pairs,
        p,
        turn_rate,
        int(rng.integers(0, 8)),
        0.01,
        (15.0, 2.7, 0.002),
        rotation(rng),
        float(rng.choice([0.0, 0.05])),
        int(rng.integers(-12, 13)),
    )


@SEEDS
@MANY
def test_manoeuvres_are_counted_across_blocks(seed: int) -> None:
    rng, share = drawn(seed)
    blocks = [spiked(rng, rng.normal(size=(2, N)).cumsum(axis=1) / 4.0, share) for _ in range(5)]

    def counted() -> object:
        driven = Manoeuvres()
        for accel, turn in blocks:
            driven.add(accel, turn)
        return driven.straight, driven.lefts, driven.rights, driven._state

    agree(counted)


@SEEDS
@MANY
def test_a_sensor_that_turns_alone(seed: int) -> None:
    rng, share = drawn(seed)
    scale = 10.0 ** rng.uniform(-3, 0)
    blocks = [
        (*spiked(rng, scale * rng.normal(size=(2, N)).cumsum(axis=1), share), flags(rng))
        for _ in range(6)
    ]

    def turned() -> object:
        alone = TurnedAlone()
        return [(alone.add(*one), alone._before) for one in blocks]

    agree(turned)


@SEEDS
@MANY
def test_large_changes(seed: int) -> None:
    rng, _ = drawn(seed)
    rows = rng.normal(size=(int(rng.integers(0, 50)), 6)) * 0.05
    rows[len(rows) // 2 :, :3] += rng.normal(size=3) * rng.choice([0.0, 0.3])
    rows[:, 3:] = np.abs(rows[:, 3:]) * [2000.0, 2000.0, 5000.0]

    def found() -> object:
        detector = large_change.LargeChangeDetector(EstimatorSettings())
        detector._rows = rows
        return detector.found(with_yaw=True)

    agree(found)


@SEEDS
@MANY
def test_the_window_and_its_spectra(seed: int) -> None:
    rng, share = drawn(seed)
    blocks = [any_block(rng, share) for _ in range(int(rng.integers(1, 7)))]
    signals = spiked(rng, rng.normal(size=(spectra.WINDOW, MEASURED)), share)
    mask = flags(rng, spectra.WINDOW)

    def window() -> object:
        vertical, window = GravityObserver(), MotionWindow()
        for p in blocks:
            vertical.use, vertical.pull = p.learn, 0.1 / 16.0
            window.add(p, p.force, p.speed * 0.1, p.yaw_rate, vertical)
        return window._values, window._mask, vertical.taken, window.spectra(True, False)

    agree(window)
    agree(spectra.spectra, signals, mask, True)
    agree(spectra.spectra, signals, mask, False)


@SEEDS
@MANY
def test_products_and_scores_of_windows(seed: int) -> None:
    rng, share = drawn(seed)
    n = int(rng.integers(1, 9))
    s = spiked(rng, rng.normal(size=(n, BINS, 2 * MEASURED)), share).view(complex)
    tau = rng.normal(size=2) * 0.2
    R, gains = rotation(rng), rng.normal(size=(len(GAINS), BANDS)) + 1.0
    first, without_speed = int(rng.integers(0, n)), bool(rng.random() < 0.3)
    angle, power = 0.02 * rng.normal(size=(n - first, 3)), 10.0 ** rng.uniform(-3, 3)

    def everything() -> object:
        products = np.zeros((spectra.PRODUCTS, n, BANDS))
        for k in range(n):
            spectra.put_products(products, k, s[k], *tau)
        products *= power
        P = spectra.in_vehicle_axes(products, R, without_speed, first, n)
        evidence = response.ResponseEvidence()
        evidence._n, evidence.noise = n, np.abs(gains[:1]) * np.ones((6, 1))
        left = scores.left_over(P, gains)
        weight = evidence._weights(left)
        evidence._renew_levels(P, weight, left)
        score = np.zeros((len(ROWS), n, MAX_REGRESSORS))
        normal = np.zeros((len(ROWS), n, MAX_REGRESSORS, MAX_REGRESSORS))
        scores.put_scores(P, weight, gains, score, normal, first)
        renewed = scores.renewed_gains(P, weight)
        less = scores.less_angle(left, P, gains, angle)
        return products, P, left, weight, evidence.nu, evidence.noise, score, normal, renewed, less

    agree(everything)


@SEEDS
@MANY
def test_sums_of_a_delay(seed: int) -> None:
    rng, share = drawn(seed)
    size = 10.0 ** rng.uniform(-3, 1)
    windows = spiked(rng, size * rng.normal(size=(5, BINS, 8)), share).view(complex)

    def searched() -> object:
        delay = DelaySearch(DelayPrior())
        for k, one in enumerate(windows):
            delay.add(one[:, 0], one[:, 1:], float(k))
        return delay._cross, delay._powers, delay.windows

    agree(searched)


@SEEDS
@MANY
def test_fits_and_changes_of_road_segments(seed: int) -> None:
    rng, share = drawn(seed)
    rows, groups = int(rng.integers(1, len(ROWS) + 1)), int(rng.integers(2, 60))
    use = sorted(rng.choice(len(ROWS), rows, replace=False).tolist())
    score = spiked(rng, rng.normal(size=(len(ROWS), groups, MAX_REGRESSORS)), share)
    root = rng.normal(size=(len(ROWS), groups, MAX_REGRESSORS, MAX_REGRESSORS))
    normal = root @ root.swapaxes(2, 3) * 10.0 ** rng.uniform(-1, 4)
    total = normal.sum(axis=1)[use]
    agree(road_segments._fitted, score, normal, use, total, road_segments._PRIORS[use])

    def changes() -> object:
        fitted, inverse = road_segments._fitted(
            score, normal, use, total, road_segments._PRIORS[use]
        )
        fits = [
            road_segments.AngleFit(fitted.left[k], normal[i, :, 0], inverse[k], 0.0)
            for k, i in enumerate(use)
        ]
        return shift._changes_of(fits, shift.SPANS)

    agree(changes)


@SEEDS
@MANY
def test_walks_and_rates_of_a_mount_that_creeps(seed: int) -> None:
    rng, share = drawn(seed)
    n = int(rng.integers(creep.FEWEST, creep.MOST + 1))
    known = 10.0 ** rng.uniform(1, 6, size=(3, n)) * (rng.random((3, n)) > 0.2)
    left = spiked(rng, rng.normal(size=(3, n)) * np.sqrt(known), share)
    each = rng.integers(1, 5, n).astype(float)
    agree(creep._filtered, left, known, each)


@SEEDS
@MANY
def test_sources_put_together(seed: int) -> None:
    rng, share = drawn(seed)
    names = [
        name
        for name in ("yaw_dvdt", "yaw_turn", "pitch_dvdt", "pitch_axis", "pitch_gravity",
                     "roll_turn", "roll_axis", "roll_gravity")
        if rng.random() < 0.7
    ] or ["yaw_turn"]  # fmt: skip
    n, more = len(names), int(rng.integers(0, 5))
    at = fusion._places(tuple(names))
    known, answers = covariance(rng, n + more), rng.normal(size=(n + more, 6))
    scales2 = np.array([0.0, 1e-4, 1e-3, 1e-2])
    values = spiked(rng, rng.normal(size=n + more), share)
    X = np.zeros((n + more, at.shown.shape[1]))
    X[:n] = at.shown
    probability = rng.random(len(scales2))
    agree(fusion._free_of_angles, known, answers, scales2, X, values)
    agree(
        fusion._means, known[:n, :n], answers[:n], scales2, values[:n], at,
        probability / probability.sum(),
    )  # fmt: skip
