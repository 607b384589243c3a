"""How much of a cross-axis error is unseen follows from how much of it is seen."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from imucald.config.calibration import CalibrationSettings
from imucald.core.samples import GRAVITY
from imucald.mount.cross_axis import SHOWN, CrossAxisFusion, ForceSeen
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.road_segments import AngleEvidence
from imucald.mount.states import HIDDEN_SLACK

Array = NDArray[np.float64]

SETTINGS = EstimatorSettings()
NOISE = {
    "yaw_dvdt": 0.003,
    "yaw_turn": 0.004,
    "pitch_dvdt": 0.003,
    "pitch_axis": 0.006,
    "roll_axis": 0.006,
    "pitch_gravity": 0.008,
    "roll_gravity": 0.008,
}
"""Of the sources after ten minutes [rad]."""
DRAWS = 300


def terms(rng: np.random.Generator, size: float) -> Array:
    E = np.zeros((3, 3))
    E[~np.eye(3, dtype=bool)] = size * rng.standard_normal(6)
    return E


def sitting(rng: np.random.Generator) -> Array:
    """R_vehicle_from_sensor with any yaw and up to 30 deg of tilt."""
    tilt = rng.uniform(-30.0, 30.0, 2)
    R: Array = Rotation.from_euler("ZYX", [rng.uniform(-180, 180), *tilt], degrees=True).as_matrix()
    return R


def forces(R: Array, E: Array) -> Array:
    """What the sensor makes of unit forces along the vehicle's axes, in its axes (3, 3)."""
    measured: Array = R @ (np.eye(3) + E) @ R.T
    return measured


def made(
    rng: np.random.Generator, R: Array, E: Array
) -> tuple[dict[str, AngleEvidence], ForceSeen]:
    """Evidence of a drive about the true R: every angle that it finds is an error."""
    F = forces(R, E)
    bias = 0.1 * rng.standard_normal(3)
    level = R @ bias / GRAVITY
    # a force to the left of a vehicle that only speeds up: a sensor turned to the right, and so on
    found = {
        "yaw_dvdt": -F[1, 0],
        "yaw_turn": F[0, 1],
        "pitch_dvdt": F[2, 0],
        "pitch_axis": 0.0,
        "roll_axis": 0.0,
        "pitch_gravity": -F[0, 2] - level[0],
        "roll_gravity": F[1, 2] + level[1],
    }
    spread = CrossAxisFusion(SETTINGS).bias_spread
    data = 0.05  # of the bias as the drive shows it by itself [m/s^2]
    share = spread**2 / (spread**2 + data**2)
    whole = R.T @ (GRAVITY * F[:, 2] - [0.0, 0.0, GRAVITY]) + bias
    bias_found = share * (whole + data * rng.standard_normal(3))
    known = R @ bias_found / GRAVITY
    found["pitch_gravity"] += known[0]
    found["roll_gravity"] -= known[1]
    sources = {}
    for name, value in found.items():
        more = (1.0 - share) * spread**2 / GRAVITY**2 if name.endswith("gravity") else 0.0
        noisy = value + NOISE[name] * rng.standard_normal()
        sources[name] = AngleEvidence(noisy, NOISE[name] ** 2 + more, 20.0)
    road = 0.01 * rng.standard_normal()
    turn = -F[2, 1] + road + 0.002 * rng.standard_normal()
    responses = {**sources, "roll_turn": AngleEvidence(turn, 1e-4, 20.0)}
    turning = AngleEvidence(turn - road, 0.002**2, 20.0)
    speed = 0.01 * rng.standard_normal()
    gains = tuple(F[i, i] + speed + 0.01 * rng.standard_normal() for i in (0, 1))
    mean = R.T @ (GRAVITY * F[:, 2]) + bias
    cov = (1.0 - share) * spread**2 * np.eye(3)
    return sources, ForceSeen(mean, bias_found, cov, (gains[0], gains[1]), responses, turning)


@pytest.mark.parametrize("size", [0.0, 0.005, 0.01, 0.02, 0.04])
def test_the_interval_of_yaw_holds_for_every_size_that_nobody_stated(size: float) -> None:
    rng = np.random.default_rng(1)
    held = 0
    for _ in range(DRAWS):
        R, E = sitting(rng), terms(rng, size)
        fused = CrossAxisFusion(SETTINGS).fused(*_with(R, made(rng, R, E)))
        held += abs(fused.error[2]) <= 1.96 * math.sqrt(fused.variance[2])
    assert held / DRAWS > 0.9


def _with(R: Array, evidence: tuple[dict[str, AngleEvidence], ForceSeen]):
    sources, force = evidence
    return sources, R, force


def stated(size: float) -> Array:
    """Standard deviations of yaw [deg] over some mounts."""
    rng = np.random.default_rng(2)
    found = []
    for _ in range(60):
        R = sitting(rng)
        fused = CrossAxisFusion(SETTINGS).fused(*_with(R, made(rng, R, terms(rng, size))))
        found.append(math.degrees(math.sqrt(fused.variance[2])))
    return np.array(found)


def test_what_is_seen_decides_what_is_stated_unseen() -> None:
    assert np.median(stated(0.0)) < 0.35
    assert 0.6 < np.median(stated(0.02)) < 1.3
    assert np.mean(stated(0.04) > 1.0) > 0.75, "mostly not usable"


@pytest.mark.parametrize("shown", [3, 4, 5])
def test_a_limit_for_usable_leaves_the_interval_whole_however_few_parts_show(shown: int) -> None:
    """Student's interval of the hidden part of 4 %, among those whose deviation is in the limit."""
    rng = np.random.default_rng(6)
    part = 0.04 / math.sqrt(2.0)
    hidden = part * rng.standard_normal(100_000)
    spread = part * np.sqrt(rng.chisquare(shown, len(hidden)) / (shown - 2))
    held = np.abs(hidden) <= 1.96 * spread
    limit = SETTINGS.limits.usable_yaw
    assert held[spread < 2.0 * limit].mean() < 0.91, "that would choose by chance"
    assert held[spread < HIDDEN_SLACK * limit].mean() > 0.92


def test_the_limit_for_usable_does_not_choose_the_mounts_that_are_wrong() -> None:
    rng = np.random.default_rng(7)
    found = []
    for _ in range(1000):
        R, E = sitting(rng), terms(rng, 0.04)
        fused = CrossAxisFusion(SETTINGS).fused(*_with(R, made(rng, R, E)))
        found.append((abs(fused.error[2]), math.sqrt(fused.variance[2])))
    error, std = np.array(found).T
    held = error <= 1.96 * std
    limit = SETTINGS.limits.usable_yaw
    assert held[std < limit].mean() < 0.8, "what shows is small there by chance"
    assert held[std < HIDDEN_SLACK * limit].mean() > 0.92
    assert (std < HIDDEN_SLACK * limit).mean() > 0.8


def test_a_mount_that_hides_the_contradiction_of_yaw_does_not_exclude_the_error() -> None:
    """At 45 deg of yaw both sources of yaw are equally wrong: that they agree says nothing."""
    rng = np.random.default_rng(3)
    R = Rotation.from_euler("Z", 45.0, degrees=True).as_matrix()
    E = np.zeros((3, 3))
    E[0, 1], E[1, 0] = 0.04, 0.04
    assert forces(R, E)[1, 0] == pytest.approx(0.0, abs=1e-12)
    sources, force = made(rng, R, E)
    fusion = CrossAxisFusion(SETTINGS)
    fusion.fused(sources, R, force)
    blind = CrossAxisFusion(SETTINGS)
    blind.fused(sources, R, ForceSeen(force.mean, force.bias, force.bias_cov, (1.0, 1.0), {}))
    assert fusion.probable > 0.02, "the response to motion shows it"
    assert blind.probable < fusion.probable


def test_each_source_shows_the_entry_that_physics_gives_it() -> None:
    rng = np.random.default_rng(4)
    R, E = sitting(rng), terms(rng, 0.03)
    C = forces(R, E) - np.eye(3)
    fusion = CrossAxisFusion(SETTINGS)
    sources, force = made(rng, R, E)
    sources["roll_turn"] = force.responses["roll_turn"]
    fusion.fused(sources, R, force)
    six = E[~np.eye(3, dtype=bool)]
    for name, entry in {
        "yaw_dvdt": -C[1, 0],
        "yaw_turn": C[0, 1],
        "pitch_dvdt": C[2, 0],
        "roll_turn": -C[2, 1],
    }.items():
        assert fusion.answers[name] @ six == pytest.approx(entry, abs=1e-12), name
    assert SHOWN.keys() | {"roll_axis", "pitch_axis"} == fusion.answers.keys()
    assert not fusion.answers["roll_axis"].any()


def test_a_configured_error_is_not_estimated() -> None:
    rng = np.random.default_rng(5)
    settings = EstimatorSettings(CalibrationSettings(cross_axis=0.01))
    fusion = CrossAxisFusion(settings)
    R = sitting(rng)
    fusion.fused(*_with(R, made(rng, R, terms(rng, 0.04))))
    assert fusion.std == pytest.approx(0.01)
