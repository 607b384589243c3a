"""Each kind of evidence by itself, on signals made from closed formulas."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imucald.core.rotations import rotation_from_angles, rotation_from_vector
from imucald.core.samples import GRAVITY
from imucald.motion.ticks import empty_rows
from imucald.mount import evidence_spectra as sp
from imucald.mount.delay import DelaySearch
from imucald.mount.estimator_settings import DelayPrior, EstimatorSettings
from imucald.mount.evidence_gravity import GravityEvidence
from imucald.mount.evidence_response import ResponseEvidence
from imucald.mount.evidence_rows import GAINS, ROWS, left_over, less_angle
from imucald.mount.evidence_spectra import Measured
from imucald.mount.fusion import CommonCovariance, CommonError, fuse
from imucald.mount.gravity_observer import GravityObserver
from imucald.mount.offsets import Offsets
from imucald.mount.road_segments import AngleEvidence
from imucald.mount.signal_blocks import BLOCK_TICKS, SignalBlockMaker
from imucald.mount.steering import SteeringOffsetEstimator
from signal_block import block

DEG = math.radians(1.0)


def smooth(rng: np.random.Generator, n: int, seconds: float) -> np.ndarray:
    window = np.hanning(int(seconds * 10))
    noise = np.convolve(rng.standard_normal(n + len(window)), window, "same")[:n]
    return noise / noise.std()


def test_overlapping_windows_keep_the_power_of_a_signal():
    n = 12000
    x = np.sin(0.2 * np.arange(n))[:, None] * np.ones((1, sp.MEASURED))  # 0.3 Hz
    mask = np.ones(sp.WINDOW, dtype=bool)
    total = sum(
        float((np.abs(sp.spectra(x[i : i + sp.WINDOW], mask)[:, Measured.DVDT]) ** 2).sum())
        for i in range(0, n - sp.WINDOW, BLOCK_TICKS)
    )
    used = x[sp.WINDOW // 2 : -sp.WINDOW // 2, 0]
    assert total == pytest.approx(float((used**2).sum()), rel=0.02)


@pytest.mark.parametrize("without_speed", [False, True])
def test_products_turn_like_the_signals(without_speed):
    rng = np.random.default_rng(4)
    R = rotation_from_angles(0.3, -0.2, 1.1)
    s = rng.standard_normal((sp.BINS, sp.MEASURED)) + 1j * rng.standard_normal(
        (sp.BINS, sp.MEASURED)
    )
    turned = s.copy()
    for first in (0, 5, 8):
        turned[:, first : first + 3] = s[:, first : first + 3] @ R.T
    here = sp.in_vehicle_axes(sp.band_products(s, 0.1, 0.0)[:, None], R, without_speed)
    there = sp.in_vehicle_axes(
        sp.band_products(turned, 0.1, 0.0)[:, None], np.eye(3), without_speed
    )
    assert np.allclose(here, there)


@pytest.mark.parametrize("late", [-0.2, 0.0, 0.35, 0.8])
def test_delay_from_the_phase(late):
    rng = np.random.default_rng(5)
    fine = smooth(rng, 60000, 15.0)  # 100 Hz
    search = DelaySearch(DelayPrior(0.1, 0.3))
    signals = np.zeros((5000, sp.MEASURED))
    at = 200 + 10 * np.arange(5000)
    signals[:, 0] = 0.8 * fine[at]
    signals[:, 1] = 0.6 * fine[at]
    signals[:, :3] += 0.3 * rng.standard_normal((5000, 3))
    signals[:, Measured.DVDT] = fine[at - round(100 * late)]
    mask = np.ones(sp.WINDOW, dtype=bool)
    for i in range(0, 4500, BLOCK_TICKS):
        s = sp.spectra(signals[i : i + sp.WINDOW], mask)
        search.add(s[:, Measured.DVDT], s[:, :3], 0.1 * i)
    assert search.search() == pytest.approx(late, abs=0.03)
    assert search.std < 0.05


def put_motion(signals: np.ndarray, dvdt: np.ndarray, lateral: np.ndarray) -> None:
    """Put dv/dt and v r (N,) into signals (N, MEASURED); the carried vertical takes up none."""
    signals[:, Measured.DVDT], signals[:, Measured.LATERAL] = dvdt, lateral
    signals[:, Measured.DVDT_REMAINING], signals[:, Measured.LATERAL_REMAINING] = dvdt, lateral


def fed(
    signals: np.ndarray, dvdt: np.ndarray, lateral: np.ndarray, R: np.ndarray, every: int
) -> ResponseEvidence:
    """Evidence of all windows of signals (N, MEASURED), which dv/dt and v r (N,) are put into.

    It is fitted about R, (3, 3) R_vehicle_from_sensor, every so many windows.
    """
    put_motion(signals, dvdt, lateral)
    evidence = ResponseEvidence()
    mask = np.ones(sp.WINDOW, dtype=bool)
    for i in range(0, len(signals) - sp.WINDOW, BLOCK_TICKS):
        evidence.add(sp.spectra(signals[i : i + sp.WINDOW], mask))
        if i % (every * BLOCK_TICKS) == 0:
            evidence.fit(R)
    return evidence


def response(
    error: np.ndarray, noise: float, seed: int, windows: int = 100
) -> dict[str, AngleEvidence]:
    """Pieces about a rotation that is wrong by `error`, from pure dv/dt and v r."""
    rng = np.random.default_rng(seed)
    n = windows * BLOCK_TICKS + sp.WINDOW
    a, v = smooth(rng, n, 8.0), 0.8 * smooth(rng, n, 6.0)
    F = np.stack([a, v, np.zeros(n)], axis=1)
    truth = rotation_from_angles(0.2, -0.1, 2.0)
    signals = np.zeros((n, sp.MEASURED))
    signals[:, :3] = F @ truth + noise * rng.standard_normal((n, 3))
    evidence = fed(signals, a, v, truth, 64)
    return evidence.fit(rotation_from_vector(-error) @ truth)


def test_response_finds_yaw_pitch_and_roll():
    error = np.array([0.6, -0.4, 0.5]) * DEG
    pieces = response(error, 0.1, 6, windows=120)
    for name, axis in (("yaw_dvdt", 2), ("yaw_turn", 2), ("pitch_dvdt", 1), ("roll_turn", 0)):
        piece = pieces[name]
        assert math.sqrt(piece.variance) < 0.4 * DEG
        assert piece.value == pytest.approx(error[axis], abs=3.0 * math.sqrt(piece.variance))


def test_windows_summed_up_at_another_delay_say_nothing_once_they_are_forgotten():
    rng = np.random.default_rng(8)
    n, old = 160 * BLOCK_TICKS + sp.WINDOW, 110 * BLOCK_TICKS
    a, v = smooth(rng, n, 8.0), 0.8 * smooth(rng, n, 6.0)
    signals = np.zeros((n, sp.MEASURED))
    signals[:, 0], signals[:, 1] = a, v
    signals[:old, :2] = (
        np.stack([a, v], axis=1)[:old] @ rotation_from_vector([0.0, 0.0, 4.0 * DEG])[:2, :2]
    )
    signals[:, :3] += 0.1 * rng.standard_normal((n, 3))
    evidence = fed(signals, a, v, np.eye(3), 16)
    assert abs(evidence.fit(np.eye(3))["yaw_dvdt"].value) > 1.0 * DEG
    evidence.forget_sums()
    assert abs(evidence.fit(np.eye(3))["yaw_dvdt"].value) < 0.4 * DEG
    assert max(len(one.score) for one in evidence.series) <= evidence.windows // 4 + 1


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_what_a_turned_window_leaves_over_is_noise_once_its_angle_is_taken_off(axis):
    rng = np.random.default_rng(11)
    a, v = smooth(rng, sp.WINDOW, 6.0), smooth(rng, sp.WINDOW, 4.0)
    error = np.zeros(3)
    error[axis] = 3.0 * DEG
    force = np.stack([a, v, np.zeros(sp.WINDOW)], axis=1)
    signals = np.zeros((sp.WINDOW, sp.MEASURED))
    signals[:, :3] = force - np.cross(error, force) + 0.01 * rng.standard_normal((sp.WINDOW, 3))
    put_motion(signals, a, v)
    s = sp.spectra(signals, np.ones(sp.WINDOW, dtype=bool))
    P = sp.in_vehicle_axes(sp.band_products(s, 0.0, 0.0)[:, None], np.eye(3))
    gains = np.zeros((len(GAINS), sp.BANDS))
    gains[:2] = 1.0
    left = left_over(P, gains)
    known = [row for row, spec in enumerate(ROWS[:4]) if spec.axis == axis]
    without = less_angle(left, P, gains, error[None])[known].sum(axis=2)
    assert (without < 0.1 * left[known].sum(axis=2)).all()
    opposite = less_angle(left, P, gains, -error[None])[known].sum(axis=2)
    assert (opposite > 2.0 * left[known].sum(axis=2)).all()


@pytest.mark.slow
def test_old_windows_stay_in_the_sums():
    error = np.array([0.0, 0.0, 1.0]) * DEG
    few = response(error, 0.3, 7, windows=110)["yaw_dvdt"]
    many = response(error, 0.3, 7, windows=600)["yaw_dvdt"]
    assert many.variance < 0.5 * few.variance
    assert many.value == pytest.approx(error[2], abs=4 * math.sqrt(many.variance))


@pytest.mark.slow
def test_intervals_of_the_response_hold_the_truth():
    inside = []
    for seed in range(30):
        piece = response(np.zeros(3), 0.3, 100 + seed, windows=60)["yaw_dvdt"]
        inside.append(abs(piece.value) < 1.96 * math.sqrt(piece.variance))
    assert np.mean(inside) >= 0.85


@pytest.mark.slow
def test_a_turn_shows_bias_from_slope():
    """On a slope the vertical turns against the sensor; a bias does not."""
    bias = np.array([0.08, -0.05, 0.0])
    slope = 0.03
    tracker = GravityObserver()
    heading, rng = 0.0, np.random.default_rng(8)
    for k in range(120):
        turning = (k // 6) % 3 == 1
        side = 1.0 if (k // 18) % 2 else -1.0
        r = np.full(BLOCK_TICKS, side * 0.3 if turning else 0.0)
        angle = heading + np.cumsum(r) * 0.1
        heading = float(angle[-1])
        up = np.stack([slope * np.cos(angle), -slope * np.sin(angle), np.ones(BLOCK_TICKS)], axis=1)
        force = GRAVITY * up + bias + 0.02 * rng.standard_normal((BLOCK_TICKS, 3))
        rate = np.stack([np.zeros(BLOCK_TICKS), np.zeros(BLOCK_TICKS), r], axis=1)
        p = block(0.1 * BLOCK_TICKS * k, force=force, rate=rate)
        tracker.advance(p, np.zeros((BLOCK_TICKS, 3)), None, sure=True)
    found, covariance = tracker.bias(0.1)
    assert found[:2] == pytest.approx(bias[:2], abs=0.02)
    assert math.sqrt(covariance[0, 0]) < 0.05


def test_places_are_counted_not_samples():
    gravity = GravityEvidence()
    rest = np.ones(BLOCK_TICKS, dtype=bool)
    for _ in range(100):
        gravity.add(block(rest=rest, speed=np.zeros(BLOCK_TICKS)), np.zeros(BLOCK_TICKS))
    assert gravity.stops == 1
    assert gravity.variance(0.02, 200.0, 0.0) == pytest.approx(0.02**2)
    for _ in range(32000 // BLOCK_TICKS):
        gravity.add(block(), np.zeros(BLOCK_TICKS))
    assert gravity.metres == pytest.approx(32000.0)
    assert gravity.variance(0.02, 200.0, 0.0) == pytest.approx(0.02**2 * 400 / 32000, rel=0.05)


def test_gravity_gives_the_tilt():
    gravity = GravityEvidence()
    true = rotation_from_vector([0.02, -0.03, 0.0])
    force = np.tile([0.0, 0.0, GRAVITY], (BLOCK_TICKS, 1)) @ true
    for _ in range(10):
        gravity.add(block(force=force), np.zeros(BLOCK_TICKS))
    e_x, e_y = gravity.tilt(np.eye(3), np.zeros(3), (1.0, 1.0))
    assert (e_x, e_y) == pytest.approx((0.02, -0.03), abs=1e-3)


def test_fusion_weighs_by_variance_and_shared_errors_do_not_average_out():
    pieces = {"yaw_a": AngleEvidence(1.0, 1.0, 9.0), "yaw_b": AngleEvidence(2.0, 4.0, 9.0)}
    fused = fuse(pieces, CommonCovariance(()))
    assert fused.error[2] == pytest.approx(1.2)
    assert fused.variance[2] == pytest.approx(0.8)
    assert fused.shares["yaw"] == pytest.approx({"yaw_a": 0.8, "yaw_b": 0.2})
    common = fuse(pieces, CommonCovariance((CommonError(3.0, {"yaw_a": 1.0, "yaw_b": 1.0}),)))
    assert common.variance[2] > 9.0
    opposite = fuse(
        {"yaw_a": AngleEvidence(3.0, 1.0, 9.0), "yaw_b": AngleEvidence(-3.0, 1.0, 9.0)},
        CommonCovariance((CommonError(3.0, {"yaw_a": 1.0, "yaw_b": -1.0}),)),
    )
    assert opposite.error[2] == pytest.approx(0.0)
    assert opposite.variance[2] == pytest.approx(0.5)


def test_pieces_that_disagree_widen_the_interval():
    agree = fuse(
        {"yaw_a": AngleEvidence(0.0, 1.0, 9.0), "yaw_b": AngleEvidence(0.5, 1.0, 9.0)},
        CommonCovariance(()),
    )
    apart = fuse(
        {"yaw_a": AngleEvidence(0.0, 1.0, 9.0), "yaw_b": AngleEvidence(6.0, 1.0, 9.0)},
        CommonCovariance(()),
    )
    assert agree.variance[2] == pytest.approx(0.5)
    assert apart.variance[2] == pytest.approx(0.5 * 18.0)


def test_a_piece_that_knows_little_does_not_widen_what_another_knows_well():
    good, poor = (
        AngleEvidence(0.0, 1.0, 9.0),
        AngleEvidence(20.0, 100.0, 9.0),
    )  # two deviations apart
    apart = fuse({"yaw_a": good, "yaw_b": poor}, CommonCovariance(()))
    assert 0.9 < apart.variance[2] < 1.2


def test_steering_offset_in_curves_of_both_sides():
    rng = np.random.default_rng(9)
    steering = SteeringOffsetEstimator()
    for _ in range(200):
        v = np.full(BLOCK_TICKS, rng.uniform(6.0, 25.0))
        r = np.full(BLOCK_TICKS, rng.normal() * 1.5 / v[0])
        angle = (
            15.0 * (2.7 + 0.003 * v * v) * r / v + 0.03 + 0.01 * rng.standard_normal(BLOCK_TICKS)
        )
        steering.add(angle, v, r, np.ones(BLOCK_TICKS, dtype=bool))
    fitted = steering.fitted(0.0, 0.0)
    assert fitted is not None
    assert fitted[0] == pytest.approx(0.03, abs=0.003)


def test_a_moving_vehicle_teaches_no_rest_offset():
    offsets = Offsets()
    force = np.tile([0.0, 0.0, GRAVITY], (BLOCK_TICKS, 1))
    offsets.learn_gyro(np.tile([0.0, 0.0, 0.3], (BLOCK_TICKS, 1)), force)
    assert offsets.gyro_ticks == 0.0
    offsets.learn_gyro(np.tile([0.001, 0.0, 0.005], (BLOCK_TICKS, 1)), force)
    assert offsets.gyro_bias == pytest.approx([0.001, 0.0, 0.005])


def test_empty_ticks_prepare_to_nothing_learnt():
    preparer = SignalBlockMaker(EstimatorSettings())
    for row in empty_rows(BLOCK_TICKS):
        complete = preparer.push(row)
    assert complete
    prepared = preparer.block()
    assert not prepared.learn.any()
    assert not prepared.ok_speed.any()
