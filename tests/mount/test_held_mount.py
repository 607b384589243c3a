"""A mount that is held: the drive may confirm or doubt it, and changes nothing."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imucald.config.calibration import KnownMount
from imucald.core.errors import EstimateError
from imucald.core.rotations import rotation_from_angles
from imucald.mount.estimate import (
    BETWEEN_DRIVES_STD,
    Correction,
    MountEstimate,
    MountState,
    Targets,
)
from imucald.mount.mount_in_force import held, mount_in_force, released
from imucald.mount.restored import Phase, RestoredEstimator, StoredMount
from imucald.runtime.estimators import known_mount

TICK = (0.0,) * 64
LEVEL = rotation_from_angles(0.0, 0.0, 0.0)
TURNED = rotation_from_angles(0.0, 0.0, math.radians(20.0))
TARGETS = Targets((0.04, 0.04, 0.02), (0.012, 0.012, 0.005))


class FixedEstimator:
    """An estimator that says what it is told to say."""

    def __init__(self, R: np.ndarray | None, state: MountState, std_deg: float = 0.2) -> None:
        self.R, self.state = R, state
        self.covariance = np.eye(3) * math.radians(std_deg) ** 2
        self.steps = 0

    @property
    def correction(self) -> Correction | None:
        return None if self.R is None else Correction.turning(self.R)

    def step(self, tick: object) -> None:
        self.steps += 1

    def gap(self) -> None:
        pass

    def estimate(self) -> MountEstimate:
        return MountEstimate(self.state, self.R, self.covariance, targets=TARGETS)


def drive(estimator: RestoredEstimator, seconds: int = 30) -> None:
    for _ in range(10 * seconds):
        estimator.step(TICK)


def stored(state: MountState = MountState.USABLE) -> StoredMount:
    return StoredMount(LEVEL, np.eye(3) * math.radians(0.3) ** 2, state)


def test_a_better_known_estimate_takes_over_from_a_mount_that_is_not_held():
    estimator = RestoredEstimator(FixedEstimator(LEVEL @ TURNED, MountState.FINE, 0.1), stored())
    drive(estimator, 60)
    assert estimator.phase is Phase.NEW


def test_a_held_mount_is_doubted_by_a_drive_that_contradicts_it_and_stays():
    estimator = RestoredEstimator(FixedEstimator(TURNED, MountState.FINE), stored(), is_held=True)
    before = estimator.correction
    drive(estimator, 120)
    assert estimator.correction == before
    assert estimator.state is MountState.SUSPECT
    assert estimator.estimate().details["restored"]["held"] is True


def test_a_held_mount_is_confirmed_by_a_drive_that_agrees_and_is_never_called_finer_than_it_is():
    estimator = RestoredEstimator(
        FixedEstimator(LEVEL, MountState.FINE, 0.05), stored(), is_held=True
    )
    assert estimator.state is MountState.RESTORED
    drive(estimator)
    assert estimator.state is MountState.USABLE
    assert estimator.phase is Phase.CONFIRMED
    waiting = estimator.estimate().waiting_for
    assert set(waiting) == {"roll", "pitch", "yaw"}
    assert "imucald release" in waiting["yaw"]


def test_holding_keeps_what_is_applied_and_its_certainty():
    running = FixedEstimator(TURNED, MountState.FINE, 0.2)
    kept = held(running)
    assert kept is not None
    assert kept.correction == running.correction
    assert kept.state is MountState.FINE
    load = np.diag(np.square(BETWEEN_DRIVES_STD))
    assert kept.estimate().covariance == pytest.approx(running.covariance + load)
    assert not kept.estimate().waiting_for


def test_what_found_the_mount_watches_it_while_it_is_held():
    running = FixedEstimator(LEVEL, MountState.FINE, 0.2)
    kept = held(running)
    assert kept is not None
    assert kept.inner is running
    drive(kept)
    assert kept.state is MountState.FINE
    running.R, running.state = TURNED, MountState.RECALIBRATING
    drive(kept, 2)
    assert kept.state is MountState.SUSPECT
    assert kept.correction == Correction.turning(LEVEL)


def test_what_is_doubted_stays_doubted_when_it_is_held_and_released():
    kept = held(FixedEstimator(TURNED, MountState.SUSPECT))
    assert kept is not None
    assert kept.state is MountState.SUSPECT
    again = released(kept, FixedEstimator(None, MountState.WAITING))
    assert again.state is MountState.SUSPECT


def test_without_a_mount_in_force_there_is_nothing_to_hold():
    assert held(FixedEstimator(None, MountState.LEVELLED)) is None
    assert mount_in_force(FixedEstimator(None, MountState.WAITING)) is None


def test_after_a_release_the_drive_takes_over_again():
    kept = held(FixedEstimator(LEVEL, MountState.USABLE))
    assert kept is not None
    again = released(kept, FixedEstimator(rotation_from_angles(0, 0, 0.001), MountState.FINE, 0.05))
    assert again.state is MountState.FINE
    drive(again, 60)
    assert again.phase is Phase.NEW


def test_a_known_mount_is_fine_only_where_it_and_the_body_are_certain_enough():
    close = KnownMount(1.0, -2.0, 30.0, (0.1, 0.1, 0.1))
    found = known_mount(close, TARGETS)
    assert found.state is MountState.FINE
    assert found.is_given
    assert found.R_vehicle_from_sensor == pytest.approx(
        rotation_from_angles(*np.radians([1.0, -2.0, 30.0]))
    )
    assert known_mount(KnownMount(0.0, 0.0, 0.0, 1.0), TARGETS).state is MountState.USABLE
    with pytest.raises(EstimateError, match=r"2 deg about z is too uncertain .* below 1.15"):
        known_mount(KnownMount(0.0, 0.0, 0.0, (0.1, 0.1, 2.0)), TARGETS)
