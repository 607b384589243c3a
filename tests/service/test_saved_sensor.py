"""What the joint estimator knows of a sensor, in the saved state: it goes on after a restart."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imucald.core.rotations import rotation_from_vector
from imucald.motion.column_ticks import ticks_from_samples
from imucald.mount.estimate import MountEstimator, MountState
from imucald.mount.estimator import JointEstimator
from imucald.mount.hysteresis import GOOD
from imucald.mount.restored import RestoredEstimator
from imucald.service.calibration_store import SENSOR
from imucald.service.saved_state import StateStore
from imucald.simulation import random_model, simulate
from mount_settings import joint_settings
from service.test_saved_evidence import Keepers
from service_files import KEY

SEED, SECOND_ROADS = 976_003, 500_000


def joint() -> JointEstimator:
    return JointEstimator(joint_settings())


def ticks(seed: int, minutes: float) -> list[Any]:
    drive = simulate(random_model(SEED, standing_first=False), seed, minutes)
    rows: list[Any] = ticks_from_samples(drive.samples, 0, int(minutes * 600)).tolist()
    return rows


def usable_after(estimator: MountEstimator, rows: list[Any]) -> float:
    for k, row in enumerate(rows):
        estimator.step(row)
        if estimator.state in GOOD:
            return k / 10.0
    return float("inf")


@pytest.fixture(scope="module")
def content(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A state file after a drive of seven minutes."""
    keepers, estimator = Keepers(tmp_path_factory.mktemp("first")), joint()
    for row in ticks(SEED, 7.0):
        estimator.step(row)
    assert estimator.state in GOOD
    keepers.keeper().close(estimator, 420.0)
    return keepers.newest().read_bytes()


@pytest.fixture
def keepers(content: bytes, tmp_path: Path) -> Keepers:
    made = Keepers(tmp_path)
    StateStore(tmp_path, KEY).path(0).write_bytes(content)
    return made


def restored(keepers: Keepers) -> RestoredEstimator:
    made = keepers.keeper().restore(joint())
    assert isinstance(made, RestoredEstimator)
    return made


@pytest.mark.slow
def test_after_a_restart_a_known_sensor_is_usable_with_the_first_window(keepers: Keepers) -> None:
    rows = ticks(SEED + SECOND_ROADS, 5.0)
    cold, again = usable_after(joint(), rows), usable_after(restored(keepers), rows)
    assert again < 40.0
    assert again < 0.7 * cold
    assert keepers.warnings == []


@pytest.mark.slow
def test_a_state_without_a_sensor_is_read_as_a_rotation(keepers: Keepers) -> None:
    keepers.rewrite(lambda content: content["evidence"].pop(SENSOR))
    made = restored(keepers)
    assert made.stored.sensor is None
    assert made.state is MountState.RESTORED
    assert made.correction is not None
    assert made.correction.is_rotation
    assert keepers.warnings == []


@pytest.mark.slow
@pytest.mark.parametrize("spoilt", [None, 3, [], {}, {"mean": "x"}, {"mean": [1e300] * 24}])
def test_a_sensor_that_makes_no_sense_costs_nothing_but_itself(
    keepers: Keepers, spoilt: object
) -> None:
    keepers.rewrite(lambda content: content["evidence"].update({SENSOR: spoilt}))
    made = restored(keepers)
    assert made.stored.sensor is None
    assert made.state is MountState.RESTORED
    assert len(keepers.warnings) == (spoilt is not None)


@pytest.mark.slow
def test_a_sensor_about_another_mount_than_the_states_is_refused(keepers: Keepers) -> None:
    turned = [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    keepers.rewrite(lambda content: content["evidence"][SENSOR].update(rotation=turned))
    made = restored(keepers)
    assert made.stored.sensor is None
    assert len(keepers.warnings) == 1


@pytest.mark.slow
def test_a_state_with_a_sensor_is_small_and_read_as_it_was_written(
    content: bytes, keepers: Keepers
) -> None:
    assert len(content) < 40_000
    kept = json.loads(content.partition(b"\n")[2])["evidence"][SENSOR]
    sensor = restored(keepers).stored.sensor
    assert sensor is not None
    np.testing.assert_allclose(sensor.mean, kept["mean"])
    np.testing.assert_allclose(sensor.rotation.ravel(), kept["rotation"])


@pytest.mark.slow
def test_the_first_frame_after_a_restart_is_corrected_as_the_last_before(
    tmp_path: Path,
) -> None:
    keepers, estimator = Keepers(tmp_path), joint()
    for row in ticks(SEED, 7.0):
        estimator.step(row)
    keepers.keeper().close(estimator, 420.0)
    made = restored(keepers)
    before, after = estimator.correction, made.correction
    assert before is not None
    assert after is not None
    sample = (3.0, -4.0, 6.0)
    for channel in ("accel", "gyro"):
        now, then = after.applied(channel, sample), before.applied(channel, sample)
        np.testing.assert_allclose(now[:2], then[:2], atol=0.003)
        assert now[2] == pytest.approx(then[2], abs=0.03)  # its gain and zero are measured by none
    was, stated = estimator.estimate().deviations, made.estimate().deviations
    assert was is not None
    assert stated is not None
    assert was.yx <= stated.yx < was.yx + np.radians(0.3)


@pytest.mark.slow
def test_a_mount_that_was_moved_while_parked_gives_way_to_the_drives_own(keepers: Keepers) -> None:
    turned = rotation_from_vector(np.radians([4.5, 2.0, 1.0]))

    def move(content: dict[str, Any]) -> None:
        for one in (content, content["evidence"][SENSOR]):
            rotation = turned @ np.array(one["rotation"]).reshape(3, 3)
            one["rotation"] = rotation.ravel().tolist()

    keepers.rewrite(move)
    made = restored(keepers)
    for row in ticks(SEED + SECOND_ROADS, 5.0):
        made.step(row)
    assert not made.serves_stored
    assert made.state in GOOD
