"""What is known of a sensor goes on: over a restart, a new mount, and not to another sensor."""

from __future__ import annotations

import json

import numpy as np
import pytest

from imucald.core.errors import EstimateError
from imucald.core.rotations import rotation_from_angles
from imucald.mount.joint.evidence import Evidence
from imucald.mount.joint.known import TERMS, KnownSensor, known_from
from imucald.mount.joint.state import Priors
from joint.planar_drive import ROTATION, Sensor, blocks, cross_talk

LEVEL_ROADS = Priors(crown=(0.0, 0.002), slope=0.002)
MIXED = np.eye(3) + np.array([[0.0, 0.05, -0.03], [-0.02, 0.0, 0.04], [0.03, -0.05, 0.0]])
SENSOR = Sensor(accel=MIXED)
REMOUNT = rotation_from_angles(0.3, -0.2, 1.1)
"""Sensor axes before from sensor axes now."""


def driven(minutes: float, sensor: Sensor, evidence: Evidence, seed: int = 0, **drive: float):
    for block in blocks(minutes, sensor, seed=seed, **drive):  # type: ignore[arg-type]
        evidence.add_block(block)
        evidence.solve_when_due()
    evidence.solve()
    return evidence


def known() -> KnownSensor:
    found = driven(10.0, SENSOR, Evidence(LEVEL_ROADS)).known_sensor
    assert found is not None
    return found


def remounted(evidence: Evidence, minutes: float, sensor: Sensor, **drive: float) -> Evidence:
    """A drive with the housing turned by REMOUNT; the sensor's terms are in its own axes."""
    for b in blocks(minutes, sensor, seed=7, **drive):  # type: ignore[arg-type]
        evidence.add_block(b._replace(force=b.force @ REMOUNT, rate=b.rate @ REMOUNT))
        evidence.solve_when_due()
    return evidence


def turned_sensor() -> Sensor:
    """The sensor whose own terms are those of SENSOR once the drive is turned by REMOUNT."""
    return Sensor(accel=REMOUNT @ MIXED @ REMOUNT.T)


def test_a_restart_goes_on_as_sure_as_before_from_the_first_window() -> None:
    fresh = driven(0.7, SENSOR, Evidence(LEVEL_ROADS), seed=3).solution
    again = driven(0.7, SENSOR, Evidence(LEVEL_ROADS, known().away()), seed=3).solution
    assert fresh is not None
    assert again is not None
    assert again.sent().xy < 0.5 * fresh.sent().xy
    assert again.sent().xy < np.radians(0.5)
    left = cross_talk(again.force, MIXED)
    assert abs(left[0, 1]) < 3.0 * again.sent().xy


def test_a_known_sensor_needs_no_bend_in_a_new_mount() -> None:
    bends = {"bends": 0.0}
    fresh = remounted(Evidence(LEVEL_ROADS), 3.0, turned_sensor(), **bends).solution
    kept = known().away()
    again = remounted(Evidence(LEVEL_ROADS, kept, is_moved=True), 3.0, turned_sensor(), **bends)
    assert fresh is not None
    assert again.solution is not None
    assert fresh.sent().xy > np.radians(1.0)
    assert again.solution.sent().xy < np.radians(1.0)
    left = again.solution.force @ REMOUNT.T @ turned_sensor().accel @ ROTATION.T - np.eye(3)
    assert abs(left[0, 1]) < 3.0 * again.solution.sent().xy


def test_a_sensor_that_was_moved_while_nobody_looked_is_found_moved() -> None:
    again = remounted(Evidence(LEVEL_ROADS, known().away()), 4.0, turned_sensor())
    assert again.solution is not None
    left = again.solution.force @ REMOUNT.T @ turned_sensor().accel @ ROTATION.T - np.eye(3)
    for place, stated in (((0, 1), again.solution.sent().xy), ((1, 0), again.solution.sent().yx)):
        assert abs(left[place]) < 3.0 * stated


def test_another_sensor_is_as_well_known_as_without_a_past() -> None:
    other = Sensor(accel=MIXED.T, zero=np.array([0.3, -0.3, 0.2]))
    fresh = driven(6.0, other, Evidence(LEVEL_ROADS), seed=3).solution
    again = driven(6.0, other, Evidence(LEVEL_ROADS, known().away()), seed=3).solution
    assert fresh is not None
    assert again is not None
    left, without = cross_talk(again.force, other.accel), cross_talk(fresh.force, other.accel)
    for place in ((0, 1), (1, 0), (2, 0)):
        assert abs(left[place] - without[place]) < np.radians(0.15)
    assert again.sent().xy == pytest.approx(fresh.sent().xy, rel=0.3)


def test_what_is_kept_is_read_as_it_was_written() -> None:
    kept = known()
    read = known_from(json.loads(json.dumps(kept.plain())))
    np.testing.assert_allclose(read.mean, kept.mean, rtol=1e-6)
    np.testing.assert_allclose(read.covariance, kept.covariance, rtol=1e-4, atol=1e-12)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("mean", [0.0] * (TERMS - 1)),
        ("mean", [float("nan")] * TERMS),
        ("mean", ["0"] * TERMS),
        ("mean", [5.0] * TERMS),
        ("covariance", [0.0] * (TERMS * (TERMS + 1) // 2)),
        ("covariance", [-1.0] * (TERMS * (TERMS + 1) // 2)),
        ("covariance", {"a": 1}),
        ("rotation", [1.0] * 9),
        ("rotation", None),
    ],
)
def test_a_kept_sensor_that_makes_no_sense_is_refused(key: str, value: object) -> None:
    content = {**known_content(), key: value}
    with pytest.raises(EstimateError):
        known_from(content)


def known_content() -> dict[str, object]:
    size = 1e-3 * np.eye(TERMS)
    return KnownSensor(np.eye(3), np.zeros(TERMS), size).plain()


def test_content_of_another_kind_is_refused() -> None:
    known_from(known_content())
    for content in (None, [], "x", {}):
        with pytest.raises(EstimateError):
            known_from(content)


@pytest.mark.parametrize("cross", [1.0, 0.999, 0.9])
def test_a_file_whose_terms_no_sensor_has_is_refused(cross: float) -> None:
    """Nearly singular matrices multiply what is sent; each number by itself is possible."""
    content = known().plain()
    content["rotation"] = np.eye(3).ravel().tolist()
    content["mean"][4] = content["mean"][6] = cross  # xy and yx of the accelerometer
    with pytest.raises(EstimateError, match="impossible for a sensor"):
        known_from(content).correction(np.eye(3))
