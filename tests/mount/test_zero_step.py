"""A zero of the accelerometer that steps across the vertical is no sensor that is turned."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_estimator import drive, good_around

from imucald.core.samples import GRAVITY, Series
from imucald.motion.ticks import TICK_S
from imucald.mount.acceptance import WHY_GRAVITY_MOVED, Acceptance
from imucald.mount.block_sums import block_sums, driven
from imucald.mount.contradictions import StandingFault
from imucald.mount.mount_changes import MountChanges
from imucald.mount.signal_blocks import BLOCK_S, BLOCK_TICKS, SignalBlock
from imucald.mount.zero_step import GravityMoved, ZeroStep
from mount_settings import joint_settings
from signal_block import block

BEFORE, AFTER = 40, 30
GRADE = 18
BEND = 1.2
"""Of each third block, left and right in turn [rad]."""
SOLVER: Any = SimpleNamespace(R=np.eye(3), gains=(1.0, 1.0), turn_rate=np.zeros(BLOCK_TICKS))
"""It knows the mount, and that nothing turns."""


def take(asked: ZeroStep, one: SignalBlock) -> None:
    asked.add(one, block_sums(one, SOLVER.turn_rate, driven(one)), SOLVER)


def cause(
    turned: tuple[float, float, float] = (0.0, 0.0, 0.0),
    zero: tuple[float, float, float] = (0.0, 0.0, 0.0),
    bends_after: bool = True,
    seed: int = 0,
    felt: tuple[float, float, float] = (0.0, 0.0, 0.0),
    gap: int | None = None,
    grade: float = 0.0,
) -> GravityMoved:
    """What is found after a sensor was turned [rad], or its zero stepped [m/s^2].

    The road's slope differs by 0.02 (rms) from block to block, and turns the sensor along. felt:
    what the gyroscope feels meanwhile [rad]. gap: number of the block before which time jumps.
    grade: of a straight road [rad], for the first `GRADE` blocks after.
    """
    rng = np.random.default_rng(seed)
    asked = ZeroStep(joint_settings())
    slope = np.zeros(2)
    for k in range(BEFORE + AFTER):
        now = 0.02 * rng.standard_normal(2)
        is_after = k >= BEFORE
        is_grade = grade != 0.0 and BEFORE <= k < BEFORE + GRADE
        now[1] += grade * is_grade
        bend = BEND * (k % 3 == 0) * (-1.0) ** k * (bends_after or not is_after) * (not is_grade)
        # a vehicle's axes; the sensor's are those turned
        turn = np.array([now[0] - slope[0], now[1] - slope[1], bend])
        force = GRAVITY * np.array([-now[1], now[0], 1.0])
        slope = now
        R = Rotation.from_rotvec(np.array(turned) if is_after else np.zeros(3)).as_matrix()
        one = block(
            BLOCK_S * k,
            force=np.tile(force @ R + np.array(zero) * is_after, (BLOCK_TICKS, 1)),
            rate=np.tile(
                (turn @ R + np.array(felt) * (k == BEFORE - 1)) / (BLOCK_TICKS * TICK_S),
                (BLOCK_TICKS, 1),
            ),
        )
        if k == gap:
            asked.restart()
        take(asked, one)
        if k == BEFORE + 3:
            asked.ask(BLOCK_S * BEFORE)
    return asked.cause


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("axis", [0, 1])
def test_gravity_that_moves_without_the_axis_of_turning_is_a_zero_that_stepped(axis, seed):
    zero = np.zeros(3)
    zero[axis] = (-1.0) ** seed
    assert cause(zero=tuple(zero), seed=seed) is GravityMoved.STEPPED


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("axis", [0, 1])
def test_an_axis_of_turning_that_goes_along_with_gravity_is_a_sensor_that_was_turned(axis, seed):
    turned = np.zeros(3)
    turned[axis] = math.radians(6.0) * (-1.0) ** seed
    assert cause(turned=tuple(turned), seed=seed) is GravityMoved.TURNED


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("grade", [0.1, -0.14])
def test_a_straight_grade_before_level_bends_is_no_zero_that_stepped(grade, seed):
    assert cause(grade=grade, seed=seed) is not GravityMoved.STEPPED


def test_without_a_bend_since_nobody_knows():
    assert cause(zero=(1.0, 0.0, 0.0), bends_after=False) is GravityMoved.UNKNOWN
    assert cause(turned=(0.0, 0.1, 0.0), bends_after=False) is GravityMoved.UNKNOWN


def test_a_turn_that_the_gyroscope_felt_while_gravity_moved_says_it_without_a_bend():
    turned = (math.radians(6.0), 0.0, 0.0)
    assert cause(turned=turned, bends_after=False, felt=turned) is GravityMoved.TURNED
    the_other_way, about_the_vertical = (-turned[0], 0.0, 0.0), (0.0, 0.0, turned[0])
    for felt in (the_other_way, about_the_vertical):
        assert cause(turned=turned, bends_after=False, felt=felt) is GravityMoved.UNKNOWN


def test_no_zero_steps_by_thirty_degrees():
    turned = (0.0, math.radians(30.0), 0.0)
    assert cause(turned=turned, bends_after=False) is GravityMoved.TURNED


def test_what_came_before_a_gap_is_not_compared_with_what_comes_after_it():
    zero = (1.0, 0.0, 0.0)
    assert cause(zero=zero, gap=BEFORE) is GravityMoved.NOTHING
    assert cause(zero=zero, gap=BEFORE + 5) is GravityMoved.STEPPED, "it was asked already"


def test_nothing_is_good_while_it_is_not_known_what_moved_gravity():
    agreed: Any = SimpleNamespace(missing_to_be_good=lambda: None)
    changes = MountChanges(joint_settings())
    flags = {"is_delay_beyond": False, "has_speed": True, "has_speed_now": True}
    question = Acceptance(agreed, changes, are_signs_known=False, **flags)
    for now in GravityMoved:
        changes.zero.cause = now
        missing = question.missing_to_be_good()
        assert missing == (WHY_GRAVITY_MOVED if now is GravityMoved.UNKNOWN else None)


def test_a_change_within_what_a_zero_may_be_off_by_is_not_asked_about():
    assert cause(zero=(0.15, 0.0, 0.0)) is GravityMoved.NOTHING
    assert cause() is GravityMoved.NOTHING


def test_a_sensor_that_is_turned_about_the_vertical_has_no_stepped_zero():
    assert cause(turned=(0.0, 0.0, 0.5)) is GravityMoved.NOTHING


def test_a_zero_that_steps_back_is_a_fault_no_more():
    asked, causes = ZeroStep(joint_settings()), []
    for k in range(120):
        bend = (k % 2) * (-1.0) ** (k // 2)
        zero = 1.0 if 40 <= k < 80 else 0.0
        rate = np.array([0.0, 0.0, bend / (BLOCK_TICKS * TICK_S)])
        force = np.tile([zero, 0.0, GRAVITY], (BLOCK_TICKS, 1))
        take(asked, block(BLOCK_S * k, force=force, rate=np.tile(rate, (BLOCK_TICKS, 1))))
        if k in (43, 83):
            asked.ask(BLOCK_S * (k - 3))
        causes.append(asked.cause)
    assert causes[79] is GravityMoved.STEPPED
    assert causes[119] is GravityMoved.NOTHING


@pytest.mark.slow
@pytest.mark.parametrize("at", [200.0, 480.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_step_in_mid_drive_is_never_good_after_a_minute_and_says_why(at, sign):
    samples = dict(drive(minutes=20.0).samples)
    upright = drive().truth.R_vehicle_from_sensor()[2]
    axis = np.zeros(3)
    axis[np.argmin(np.abs(upright))] = sign
    series = samples["accel"]
    samples["accel"] = Series(series.t, series.values + (series.t >= at)[:, None] * axis)
    was_good, since, estimate = good_around(samples, at, 12000)
    assert was_good
    assert not any(since)
    assert StandingFault.ACCEL_ZERO.value in estimate.faults
    assert "zero has changed" in estimate.waiting_for["roll"]
