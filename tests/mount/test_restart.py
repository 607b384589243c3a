"""A restart between two drives: the mount and the sensor's own errors go on."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from imucald.motion.column_ticks import ticks_from_samples
from imucald.mount.estimate import MountState
from imucald.mount.estimator import JointEstimator
from imucald.mount.hysteresis import BAD, GOOD
from imucald.mount.mount_in_force import mount_in_force
from imucald.mount.restored import RestoredEstimator, StoredMount
from imucald.runtime.estimators import estimator_for
from simulated_bus import drive, loaded


def rows(seed: int, minutes: float) -> list[list[float]]:
    made = drive(seed, minutes)
    return list(ticks_from_samples(made.samples, 0, int(minutes * 600)).tolist())


def estimator() -> JointEstimator:
    made = estimator_for(loaded().config)
    assert isinstance(made, JointEstimator)
    return made


@cache
def stored() -> StoredMount:
    """What a drive of eight minutes leaves."""
    first = estimator()
    for row in rows(3, 8.0):
        first.step(row)
    found = mount_in_force(first)
    assert found is not None
    assert found.sensor is not None
    return found


def turned(mount: StoredMount, degrees: tuple[float, float, float]) -> StoredMount:
    """The same as if the sensor had been turned since, about the vehicle's axes."""
    R = Rotation.from_euler("xyz", degrees, degrees=True).as_matrix()
    assert mount.sensor is not None
    sensor = mount.sensor._replace(rotation=R @ mount.sensor.rotation)
    return replace(
        mount, R_vehicle_from_sensor=R @ mount.R_vehicle_from_sensor, sensor=sensor, applied=None
    )


def second_drive(
    mount: StoredMount, minutes: float
) -> tuple[RestoredEstimator, set[MountState], float]:
    """The estimator after it, the states on the way, when its own estimate was good [s]."""
    restored = RestoredEstimator(estimator(), mount)
    states, good = set(), math.inf
    for k, row in enumerate(rows(3, minutes)):
        restored.step(row)
        states.add(restored.state)
        if restored.inner.state in GOOD:
            good = min(good, 0.1 * k)
    return restored, states, good


@pytest.mark.slow
def test_a_known_sensor_is_found_again_sooner_and_nothing_is_called_suspect() -> None:
    restored, states, good = second_drive(stored(), 8.0)
    assert not states & BAD
    assert restored.state is MountState.FINE
    _, _, afresh = second_drive(replace(stored(), sensor=None, applied=None, sent=None), 8.0)
    assert good < afresh


@pytest.mark.parametrize("degrees", [(3.5, 0.0, 0.0), (0.0, 2.0, 0.0), (0.0, 0.0, -2.0)])
def test_a_sensor_moved_a_little_while_parked_is_found_out(
    degrees: tuple[float, float, float],
) -> None:
    restored, states, _ = second_drive(turned(stored(), degrees), 10.0)
    assert MountState.SUSPECT in states
    true = drive(3, 10.0).truth.mounts[0][1]
    R = restored.estimate().R_vehicle_from_sensor
    assert R is not None
    assert np.degrees(Rotation.from_matrix(true @ R.T).magnitude()) < 1.2
