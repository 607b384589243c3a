"""A change of the mount that misleads nobody: reported, in the interval, never *suspect*."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucald.core.rotations import rotation_from_angles, vector_from_rotation
from imucald.motion.column_ticks import ticks_from_samples
from imucald.mount.estimate import MountState
from imucald.mount.estimator import JointEstimator
from imucald.mount.explanation import change_details
from imucald.mount.hand_moves import HandMove
from imucald.mount.hysteresis import BAD
from imucald.mount.joint.moves import Move
from imucald.mount.mount_changes import GoodMount, MountChanges, SuddenTurn, blocks_since
from imucald.mount.mount_words import change_words, is_move
from imucald.mount.signal_blocks import BLOCK_S
from imucald.simulation import random_model, simulate
from mount_settings import joint_settings
from signal_block import block

DEG = math.pi / 180.0
PITCH, YAW = 1, 2


def changes() -> MountChanges:
    return MountChanges()


def shift(axis: int, degrees: float) -> Move:
    return Move(axis, degrees * DEG, math.copysign(5.0, degrees), 16, 1.0)


@pytest.mark.parametrize(
    ("degrees", "std", "bearable"),
    [(0.9, 0.1, True), (1.1, 0.1, False), (-1.1, 0.3, True), (-1.3, 0.3, False)],
)
def test_a_change_within_a_degree_or_four_deviations_misleads_nobody(degrees, std, bearable):
    assert changes().is_bearable(shift(YAW, degrees), std * DEG) is bearable


@pytest.mark.parametrize(
    "change",
    [
        SuddenTurn(PITCH, 3.0 * DEG, 9.0, 5, np.array([0.0, 3.0 * DEG, 0.0])),
        HandMove(PITCH, 3.0 * DEG, 9.0, blocks=5),
    ],
)
def test_what_comes_after_a_change_leaves_out_the_block_that_may_hold_it(change):
    kept = [block(BLOCK_S * k) for k in range(12)]
    assert [p.t[0] for p in blocks_since(change, kept)] == [p.t[0] for p in kept[-4:]]


def good(R: Any, std_deg: float = 0.5) -> GoodMount:
    rows = tuple(np.asarray(R, dtype=float).ravel().tolist())
    return GoodMount(rows, (std_deg * DEG,) * 3)


def test_a_turn_is_measured_by_the_mounts_before_and_after_it():
    """R_after = turn R_before, about the vehicle's axes; not known where one is missing."""
    before = rotation_from_angles(0.3, -0.2, 2.0)
    turn = np.array([0.0, 0.17, 0.02])
    after = Rotation.from_rotvec(turn).as_matrix() @ before
    watched = changes()
    for mount in (None, good(before)):
        watched.end_of_mounting(mount)
        watched.note_change(shift(0, 3.0), 50, 0.5 * DEG, mount)
    assert watched.turns(None) == [None, None]
    first, second = watched.turns(good(after, 0.7))
    assert first is None
    assert second is not None
    assert second[0] == pytest.approx(turn)
    assert np.degrees(second[1]) == pytest.approx(0.7)


def test_what_comes_later_does_not_change_the_turn_that_was_measured():
    before, after, later = (rotation_from_angles(0.3, p, 2.0) for p in (-0.2, -0.1, 0.3))
    watched = changes()
    watched.note_change(shift(PITCH, 3.0), 50, 0.5 * DEG, good(before))
    watched.end_of_mounting(good(after))
    watched.bear(shift(YAW, 0.8), 70, 0.5 * DEG, None)
    turn, borne = watched.turns(good(later))
    assert borne is None, "the mount went on as it was"
    assert turn is not None
    assert math.hypot(*turn[0]) == pytest.approx(0.1)


@pytest.mark.parametrize(("degrees", "is_within"), [(0.0, True), (0.9, True), (1.1, False)])
def test_a_sensor_was_moved_where_the_mount_is_found_further_off_than_its_interval(
    degrees, is_within
):
    """After a change that is borne, and after one that is not."""
    turned = good(Rotation.from_rotvec([0.0, degrees * DEG, 0.0]).as_matrix())
    for is_borne in (True, False):
        watched = changes()
        if is_borne:
            watched.bear(shift(PITCH, 1.5), 70, 0.5 * DEG, good(np.eye(3)))
        else:
            watched.note_change(shift(PITCH, 3.0), 90, 0.5 * DEG, good(np.eye(3)))
        (one,) = watched.history
        told = change_details(one, watched.turns(None)[0])
        assert is_move(told) is not is_borne, "until the mount after it is known"
        if is_borne:
            watched.know_borne()
        told = change_details(one, watched.turns(turned)[0])
        assert is_move(told) is not is_within
        assert ("moved" in change_words(told)) is not is_within


def test_the_same_change_is_reported_once_and_the_way_back_again():
    watched = changes()
    assert watched.bear(shift(YAW, 0.8), 70, 0.1 * DEG, None)
    assert not watched.bear(shift(YAW, 0.9), 72, 0.1 * DEG, None)
    assert watched.borne[YAW] == pytest.approx(0.9 * DEG)
    assert watched.bear(shift(YAW, -0.8), 90, 0.1 * DEG, None)
    assert len(watched.history) == 2


@pytest.mark.slow
def test_a_mount_that_slips_by_a_degree_is_reported_and_right_again_within_half_a_minute():
    seed, start, slip = 580_001, 700.0, 0.9
    changed = {"mount.shifts": [{"t_s": start, "yaw_deg": slip}]}
    made = simulate(random_model(seed, standing_first=True).with_changes(changed), seed, 25.0)
    estimator = JointEstimator(joint_settings())
    before = made.truth.R_vehicle_from_sensor(0.0)
    after = made.truth.R_vehicle_from_sensor(start + 1.0)
    assert np.degrees(np.abs(vector_from_rotation(after @ before.T))).max() == pytest.approx(slip)
    bad = 0
    for row in ticks_from_samples(made.samples, 0, 15_000).tolist():
        estimator.step(row)
        bad += estimator.state in BAD
    assert 0.1 * bad < 30.0
    assert estimator.state is MountState.FINE
    estimate = estimator.estimate()
    shifts = estimate.details["shifts"]
    assert isinstance(shifts, list)
    assert [one["angle"] for one in shifts] == ["yaw"]
    assert estimate.R_vehicle_from_sensor is not None
    assert estimate.std is not None
    left = after @ estimate.R_vehicle_from_sensor.T
    assert abs(vector_from_rotation(left)[YAW]) < 3.0 * estimate.std[YAW]
    assert math.degrees(estimate.std[YAW]) < 0.5
