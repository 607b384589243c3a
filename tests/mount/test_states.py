"""States and reasons."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace

from imucald.motion.column_ticks import ticks_from_samples
from imucald.mount.estimate import Missing, MountState
from imucald.mount.estimator import JointEstimator
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.states import (
    SLACK,
    WIDE_SLACK,
    Manoeuvres,
    MountKnowledge,
    is_mount_uncertain,
    judged,
    reported,
    waiting_for,
)
from imucald.simulation import random_model, simulate
from mount_settings import joint_settings

SETTINGS = EstimatorSettings()
DEG = math.radians(1.0)


def known(yaw_deg: float, tilt_deg: float = 0.3, straight: int = 5) -> MountKnowledge:
    std = (tilt_deg * DEG, tilt_deg * DEG, yaw_deg * DEG)
    talk = (yaw_deg * DEG, 0.05 * DEG)
    seen = {"straight": straight, "lefts": 2, "rights": 2}
    return MountKnowledge(gravity=True, std=std, cross_talk=talk, **seen)


def test_states_by_standard_deviation():
    waiting = MountState.WAITING
    assert judged(MountKnowledge(), waiting, SETTINGS) == MountState.WAITING
    assert judged(known(5.0), waiting, SETTINGS) == MountState.LEVELLED
    assert judged(known(0.9), waiting, SETTINGS) == MountState.USABLE
    assert judged(known(0.2), waiting, SETTINGS) == MountState.FINE
    assert judged(known(0.2, tilt_deg=5.0), waiting, SETTINGS) == MountState.LEVELLED


@pytest.mark.parametrize(
    ("state", "limit", "slack"),
    [
        (MountState.USABLE, SETTINGS.limits.usable_yaw, SLACK),
        (MountState.FINE, SETTINGS.limits.fine_yaw, SLACK),
    ],
)
def test_a_state_is_left_only_well_beyond_its_limit(state, limit, slack):
    just_over = known(math.degrees(limit) * (slack - 0.05))
    assert judged(just_over, MountState.LEVELLED, SETTINGS) != state
    assert judged(just_over, state, SETTINGS) == state
    assert judged(known(math.degrees(limit) * (slack + 0.05)), state, SETTINGS) != state


@pytest.mark.parametrize(
    ("of_sound", "has_moved", "before", "expected"),
    [
        (3.0, False, MountState.USABLE, MountState.LEVELLED),
        (0.5, False, MountState.USABLE, MountState.SUSPECT),
        (3.0, True, MountState.USABLE, MountState.SUSPECT),
        (3.0, False, MountState.SUSPECT, MountState.SUSPECT),
        (0.5, False, MountState.LEVELLED, MountState.LEVELLED),
    ],
)
def test_a_mount_that_is_no_longer_certain_is_suspect_only_if_it_is_doubted(
    of_sound, has_moved, before, expected
):
    """of_sound: deviation in yaw [deg] if neither a move nor a drift is possible."""
    now = known(3.0)
    now = replace(now, std_of_sound=(*now.std[:2], of_sound * DEG))
    found = judged(now, before, SETTINGS)
    is_uncertain = is_mount_uncertain(now, SETTINGS)
    assert reported(found, before, False, True, has_moved, is_uncertain) == expected


def test_without_a_gyroscope_a_state_is_left_later_because_it_rests_on_few_pieces():
    limit = math.degrees(SETTINGS.limits.usable_yaw)
    wide, wider = known(limit * (SLACK + 0.05)), known(limit * (WIDE_SLACK + 0.05))
    assert judged(wide, MountState.USABLE, SETTINGS) < MountState.USABLE
    assert judged(replace(wide, has_gyro=False), MountState.USABLE, SETTINGS) == MountState.USABLE
    assert judged(replace(wider, has_gyro=False), MountState.USABLE, SETTINGS) < MountState.USABLE


def test_where_no_signal_shows_turns_that_is_the_reason_for_roll():
    tilted = replace(known(0.4), std=(5.0 * DEG, 0.1 * DEG, 0.1 * DEG), turning=False)
    assert waiting_for(tilted, SETTINGS)["roll"][0].startswith("a gyroscope, a yaw rate or")


def test_before_a_first_solution_every_angle_waits_for_changes_of_speed_and_bends():
    begun = MountKnowledge(gravity=True, straight=1, lefts=1)
    reasons = waiting_for(begun, SETTINGS)
    text = "acceleration or braking above 1 m/s2, and bends (1 and 1 seen)"
    assert reasons == dict.fromkeys(("yaw", "roll", "pitch"), (text, Missing.ACCELERATION))
    braked = waiting_for(replace(begun, straight=5), SETTINGS)
    assert braked["yaw"][1] is Missing.TURNS


def test_one_reason_per_angle():
    reasons = waiting_for(known(3.0, tilt_deg=2.0), SETTINGS, MountState.LEVELLED)
    assert reasons["yaw"][0].startswith("bends (up axis ±6 deg, usable below ±2 deg)")
    assert reasons["yaw"][1] is Missing.TURNS
    assert reasons["pitch"][1] is Missing.MORE_DRIVING
    assert reasons["roll"][1] is Missing.MORE_DRIVING
    assert waiting_for(known(0.1), SETTINGS) == {}


def test_what_is_absent_comes_first():
    assert (
        waiting_for(MountKnowledge(accelerometer=False), SETTINGS)["yaw"][1]
        == Missing.ACCELEROMETER
    )
    assert waiting_for(MountKnowledge(frozen=True), SETTINGS)["roll"][1] == Missing.LEARNING_FROZEN
    silent = MountKnowledge(gravity=True, speed=False)
    assert waiting_for(silent, SETTINGS)["yaw"][1] == Missing.SPEED


def test_manoeuvres_are_counted_once_each():
    driven = Manoeuvres()
    push = np.zeros(100)
    push[10:30] = 1.5  # a launch
    push[15] = 0.9  # with a gear change in it
    push[50:53] = 1.5  # a bump
    push[60:80] = -2.0  # a braking
    turn = np.zeros(100)
    turn[40:60] = 1.0
    driven.add_accelerations(push, turn)
    assert (driven.straight, driven.lefts, driven.rights) == (2, 1, 0)


def test_a_manoeuvre_over_the_edge_of_two_hops_counts_once():
    driven = Manoeuvres()
    driven.add_accelerations(np.concatenate([np.zeros(29), np.full(3, 1.5)]), np.zeros(32))
    driven.add_accelerations(np.concatenate([np.full(10, 1.5), np.zeros(22)]), np.zeros(32))
    assert driven.straight == 1


@pytest.mark.slow
def test_a_moved_sensor_is_suspect_then_found_again():
    seed, start = 77, 420.0
    shift = {"t_s": start, "yaw_deg": 5.0}
    model = random_model(seed, standing_first=True).with_changes({"mount.shifts": [shift]})
    made = simulate(model, seed, 14.0)
    estimator = JointEstimator(joint_settings())
    states: list[tuple[float, MountState]] = []
    served = None
    for row in ticks_from_samples(made.samples, 0, 8400).tolist():
        estimator.step(row)
        if not states or estimator.state != states[-1][1]:
            states.append((row[0], estimator.state))
        if estimator.state in {MountState.SUSPECT, MountState.RECALIBRATING}:
            assert estimator.correction is not None  # the last good one is still served
            if served is not None:
                R, last = (c.matrix() for c in (estimator.correction, served))
                assert np.abs(R - last).max() < 0.002
        served = estimator.correction
    suspect = [t for t, state in states if state == MountState.SUSPECT]
    assert len(suspect) == 1
    assert start < suspect[0] < start + 120.0
    assert states[-1][1] in {MountState.USABLE, MountState.FINE}
    (shift_found,) = estimator.estimate().details["shifts"]
    assert shift_found["angle"] == "yaw"
    assert abs(abs(shift_found["size_deg"]) - 5.0) < 2.0
    x, y, z = shift_found["turn_deg"]
    assert abs(abs(z) - 5.0) < 1.0
    assert math.copysign(1.0, z) == math.copysign(1.0, shift_found["size_deg"])
    assert max(abs(x), abs(y)) < 1.5
    R = estimator.estimate().R_vehicle_from_sensor
    assert R is not None
    apart = np.degrees(np.abs(made.truth.R_vehicle_from_sensor() - R).max())
    assert apart < 1.5
