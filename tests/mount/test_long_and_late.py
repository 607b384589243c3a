"""What comes late, stays long or contradicts everything: nothing crashes, nothing is invented."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from imucald.core.rotations import rotation_from_vector
from imucald.motion import ticks as tk
from imucald.motion.column_ticks import ticks_from_samples
from imucald.mount.estimate import MountState
from imucald.mount.estimator import JointEstimator
from imucald.mount.hysteresis import GOOD
from imucald.mount.joint import evidence
from imucald.mount.joint.evidence import Evidence
from imucald.mount.restored import RestoredEstimator, StoredMount
from imucald.simulation import random_model, simulate
from mount_settings import joint_settings

Array = NDArray[np.float64]
SEED, MINUTES = 20, 12.0


def rows() -> Array:
    made = simulate(random_model(SEED), SEED, MINUTES)
    return np.asarray(ticks_from_samples(made.samples, 0, int(600 * MINUTES), {}))


@pytest.mark.slow
def test_when_all_windows_are_forgotten_the_last_solution_serves(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As after an hour with the ignition on, or without a speed."""
    monkeypatch.setattr(evidence, "MOST_BLOCKS", 50)
    monkeypatch.setattr(evidence, "KEPT_BLOCKS", 3)
    silent = rows()
    silent[3600:, tk.SPEED.n] = 0.0
    silent[3600:, [tk.SPEED.mean, tk.SPEED.age]] = np.nan
    estimator = JointEstimator(joint_settings())
    for row in silent.tolist():
        estimator.step(row)
    assert estimator._joint.segment == 0
    assert estimator.state is MountState.USABLE


@pytest.mark.slow
def test_a_speed_that_comes_late_delays_the_mount_by_no_more_than_that() -> None:
    ticks, late = rows(), rows()
    late[:3000, tk.SPEED.n] = 0.0
    late[:3000, [tk.SPEED.mean, tk.SPEED.age]] = np.nan
    first = [first_good(one) for one in (ticks, late)]
    assert first[1] < 300.0 + 1.5 * first[0]


def first_good(ticks: Array) -> float:
    estimator = JointEstimator(joint_settings())
    for row in ticks.tolist():
        estimator.step(row)
        if estimator.state in GOOD:
            return float(row[tk.T])
    return math.inf


@pytest.mark.slow
def test_a_wrong_mount_is_left_once_and_a_contradiction_of_all_signals_raises_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made = simulate(random_model(SEED), SEED, MINUTES)
    estimator = JointEstimator(joint_settings())
    for row in rows().tolist():
        estimator.step(row)
    known = estimator.known_sensor()
    assert known is not None
    wrong = rotation_from_vector([0.0, 0.0, 0.1]) @ made.truth.R_vehicle_from_sensor()
    sensor = known._replace(rotation=rotation_from_vector([0.0, 0.0, 0.1]) @ known.rotation)
    covariance = math.radians(0.2) ** 2 * np.eye(3)
    stored = StoredMount(wrong, covariance, MountState.FINE, sensor=sensor)
    restored, left = RestoredEstimator(JointEstimator(joint_settings()), stored, is_held=True), []
    leave = Evidence.leave_mount

    def counted(self: Evidence) -> None:
        left.append(1)
        leave(self)

    monkeypatch.setattr(Evidence, "leave_mount", counted)
    mirrored = rows()
    mirrored[2000:, tk.ACCEL.z] *= -1.0
    for row in mirrored.tolist():
        restored.step(row)
        assert restored.state not in GOOD
    assert len(left) <= 1


@pytest.mark.slow
def test_creep_is_kept_while_windows_are_made_again() -> None:
    changed = [{"t_s": float(t), "yaw_deg": 0.1} for t in range(60, 1500, 18)]
    model = random_model(SEED).with_changes({"mount.shifts": changed})
    made = simulate(model, SEED, 25.0)
    estimator, lost, had = JointEstimator(joint_settings()), 0, False
    for row in ticks_from_samples(made.samples, 0, 15_000, {}).tolist():
        before = estimator._joint
        estimator.step(row)
        has = estimator._creep is not None
        lost += had and not has and estimator._joint is before
        had = has
    assert had
    assert lost == 0
