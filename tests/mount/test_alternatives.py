"""Wrong signs and exchanged axes against what was configured; signals made by hand."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest
from msgspec.structs import replace
from numpy.typing import NDArray

from imucald.config.calibration import CalibrationSettings, OrientationSettings
from imucald.core.rotations import rotation_from_angles
from imucald.core.samples import GRAVITY
from imucald.mount.alternatives import Alternatives
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.log_ratios import TO_ACCUSE, TO_BE_FINE, TO_BE_GOOD, Mirrored
from imucald.mount.signal_blocks import BLOCK_TICKS, SignalBlock
from mount_settings import joint_settings

R = rotation_from_angles(0.3, -0.2, 1.1)
ALL = {"accel", "gyro", "speed", "yaw_rate", "steering"}
YES = np.ones(BLOCK_TICKS, dtype=bool)


def block(k: int, speed: float = 15.0, rough: float = 0.02, bend: float = 0.1) -> SignalBlock:
    """6.4 s on a road whose slope and bank swing, in bends to both sides."""
    t = 0.1 * (np.arange(BLOCK_TICKS) + k * BLOCK_TICKS)
    pitch, roll = rough * np.sin(0.9 * t), rough * np.cos(0.7 * t)
    yaw_rate = bend * np.sin(0.31 * t)
    pitch_rate = np.gradient(pitch, t) + yaw_rate * roll
    roll_rate = np.gradient(roll, t) - yaw_rate * pitch
    accel = 0.5 * np.sin(0.2 * t)
    noise = np.random.default_rng(k).normal(0.0, 0.02, (2, BLOCK_TICKS, 3))
    vehicle = np.column_stack(
        [
            accel - GRAVITY * pitch,
            speed * yaw_rate + GRAVITY * roll,
            np.full(BLOCK_TICKS, GRAVITY),
        ]
    )
    rates = np.column_stack([roll_rate, pitch_rate, yaw_rate])
    nothing = np.zeros(BLOCK_TICKS)
    return SignalBlock(
        t=t,
        force=(vehicle + noise[0]) @ R,
        rate=(rates + 0.1 * noise[1]) @ R,
        speed=np.full(BLOCK_TICKS, speed),
        accel=accel,
        yaw_rate=yaw_rate,
        ok_force=YES,
        ok_rate=YES,
        ok_speed=YES,
        ok_yaw=YES,
        rest=~YES,
        learn=YES,
        steering=yaw_rate,
        ok_steering=YES,
        had_rate=YES,
        gyro_bias=nothing[:3],
    )


def looked_at(
    sensor: NDArray[np.float64] | None = None,
    signals: frozenset[str] = frozenset(ALL),
    blocks: int = 20,
    speed: float = 15.0,
    rough: float = 0.02,
    bend: float = 0.1,
    yaw_sign: float = 1.0,
) -> Alternatives:
    found = Alternatives(joint_settings())
    kept: list[SignalBlock] = []
    for k in range(blocks):
        p = block(k, speed, rough, bend)
        rate = p.rate if sensor is None else p.rate @ sensor.T
        kept.append(replace(p, rate=rate, yaw_rate=yaw_sign * p.yaw_rate))
        found.take_block(kept, R, np.zeros(3), (1.0, 1.0), set(signals), 0.0)
    return found


def test_sound_signals_rule_every_alternative_out():
    found = looked_at()
    assert found.missing(TO_BE_FINE) is None
    assert not found.gyro_accused


def exchanged(i: int, j: int) -> NDArray[np.float64]:
    order = [0, 1, 2]
    order[i], order[j] = j, i
    return np.eye(3)[order]


@pytest.mark.parametrize(
    "sensor",
    [exchanged(0, 1), exchanged(1, 2), exchanged(0, 2), -np.eye(3)]
    + [np.diag(signs) for signs in ([-1.0, 1, 1], [1, -1.0, 1], [1, 1, -1.0])],
)
def test_a_wrong_sign_or_exchange_of_the_gyroscope_is_seen_and_nothing_is_good(sensor):
    found = looked_at(sensor)
    assert found.gyro_accused
    assert not found.are_seen(TO_BE_GOOD)


@pytest.mark.parametrize("signs", [[-1.0, 1, 1], [1, -1.0, 1], [1, 1, -1.0]])
def test_a_sign_of_the_gyroscope_that_turns_in_mid_drive_is_seen_within_a_minute(signs):
    found, kept = Alternatives(joint_settings()), []
    for k in range(80):
        p = block(k)
        kept.append(replace(p, rate=p.rate * np.array(signs)) if k >= 70 else p)
        found.take_block(kept[-55:], R, np.zeros(3), (1.0, 1.0), ALL, 0.0)
        assert k >= 70 or not found.gyro_accused
    assert found.gyro_accused


@pytest.mark.parametrize("has_yaw_rate", [False, True])
def test_without_a_signal_that_shows_turns_the_missing_signal_is_named(has_yaw_rate):
    found, kept = Alternatives(joint_settings()), []
    signals = {"accel", "speed", *(["yaw_rate"] if has_yaw_rate else [])}
    for k in range(40):
        ok_yaw = YES if has_yaw_rate else ~YES
        kept.append(replace(block(k), ok_rate=~YES, ok_steering=~YES, ok_yaw=ok_yaw))
        found.take_block(kept, None if k < 5 else R, np.zeros(3), (1.0, 1.0), signals, 0.0)
    text = found.missing(TO_BE_GOOD)
    if has_yaw_rate:
        assert text is None
        found.restart()
        assert "bends" in found.missing(TO_BE_GOOD)
    else:
        assert "a gyroscope, a yaw rate or a steering angle" in text


def test_a_flat_straight_road_says_nothing_either_way():
    found = looked_at(rough=0.0, bend=0.0)
    assert not found.are_seen(TO_BE_GOOD)
    assert not found.gyro_accused


def test_a_yaw_rate_the_other_way_is_never_seen_to_agree():
    assert "bends" in str(looked_at(yaw_sign=-1.0).missing(TO_BE_GOOD))


def test_slow_driving_does_not_tell_forwards_from_backwards_without_a_signal():
    alone = frozenset({"accel", "gyro", "speed"})
    assert "40 km/h" in str(looked_at(signals=alone, speed=8.0).missing(TO_BE_GOOD))
    assert looked_at(signals=alone, speed=15.0).missing(TO_BE_GOOD) is None
    assert looked_at(signals=alone | {"reverse"}, speed=8.0).missing(TO_BE_GOOD) is None


def test_without_yaw_rate_and_steering_it_says_what_nobody_checked():
    assert looked_at(signals=frozenset({"accel", "gyro", "speed"})).not_checked
    assert not looked_at().not_checked


ALONE = frozenset({"accel", "gyro", "speed"})


def heading_of(p: SignalBlock, sign: float) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """A course, clockwise, a second late as receivers give it."""
    late = np.interp(p.t - 1.0, p.t, p.yaw_rate)
    return -sign * np.cumsum(late) * 0.1, YES


def beside(
    sign: float,
    *channels: str,
    stated: Mapping[str, str] | None = None,
    mirrored: bool = False,
    are_sides_turned: bool = False,
) -> Alternatives:
    """What the usual drive shows to one that has these signals beside the sensor; sign: theirs."""
    calibration = CalibrationSettings(orientation=OrientationSettings(**(stated or {})))  # type: ignore[arg-type]
    found = Alternatives(EstimatorSettings(calibration, are_sides_turned=are_sides_turned))
    kept: list[SignalBlock] = []
    turned = np.diag([-1.0, 1.0, -1.0]) @ R if mirrored else R
    for k in range(40):
        p = block(k)
        signals = {"lateral_accel": (sign * 15.0 * p.yaw_rate, YES), "heading": heading_of(p, sign)}
        force = -p.force if mirrored else p.force
        kept.append(replace(p, force=force, sided={c: signals[c] for c in channels}))
        seen = set(ALONE | set(channels))
        found.take_block(kept, turned, np.zeros(3), (1.0, 1.0), seen, 0.0)
    return found


def test_the_mirror_image_fits_as_well_where_nothing_knows_left_from_right():
    for mirrored in (False, True):
        found = beside(1.0, mirrored=mirrored)
        assert found.missing(TO_BE_FINE) is None
        assert not found.is_mirror_excluded
        assert found.not_checked


def test_a_signal_whose_sign_was_turned_confirms_no_signs_of_the_accelerometer():
    found = beside(1.0, "lateral_accel", are_sides_turned=True)
    assert not found.is_mirror_excluded
    assert "sign: -1" in found.not_checked[0]
    assert beside(1.0, "lateral_accel", are_sides_turned=True, stated={"up": "z"}).not_checked == ()
    assert beside(1.0, "heading", are_sides_turned=True).is_mirror_excluded


@pytest.mark.parametrize("channel", ["lateral_accel", "heading"])
def test_a_lateral_acceleration_or_a_course_rules_the_mirror_image_out(channel):
    found = beside(1.0, channel)
    assert found.is_mirror_excluded
    assert found.missing(TO_BE_FINE) is None
    assert not found.not_checked


@pytest.mark.parametrize("channel", ["lateral_accel", "heading"])
def test_signs_turned_against_a_lateral_acceleration_or_a_course_are_never_good(channel):
    found = beside(1.0, channel, mirrored=True)
    assert not found.is_mirror_excluded
    assert "bends" in str(found.missing(TO_BE_GOOD))


def test_the_axis_that_points_up_rules_the_mirror_image_out_and_contradicts_it():
    assert R[2, 2] > 0.9  # z points up
    sound = beside(1.0, stated={"up": "z"})
    assert sound.is_mirror_excluded
    assert sound.contradicted_orientation(R, yaw_known=True) is None
    turned = np.diag([-1.0, 1.0, -1.0]) @ R
    mirrored = beside(1.0, stated={"up": "z"}, mirrored=True)
    assert not mirrored.is_mirror_excluded
    assert mirrored.contradicted_orientation(turned, yaw_known=False) == "up"


def test_an_axis_that_is_nearly_level_says_nothing_of_which_way_is_up():
    assert abs(R[2, 0]) < 0.5
    found = beside(1.0, stated={"up": "x"})
    assert not found.is_mirror_excluded
    assert found.contradicted_orientation(R, yaw_known=True) is None


def test_a_stated_forward_axis_knows_forward_from_backward_at_walking_pace():
    calibration = CalibrationSettings(orientation=OrientationSettings(forward="-y"))
    assert R[0] @ [0.0, -1.0, 0.0] > 0.5
    found = Alternatives(EstimatorSettings(calibration))
    for k in range(40):
        found.take_block([block(k, speed=5.0)], R, np.zeros(3), (1.0, 1.0), set(ALONE), 0.0)
    assert found.missing(TO_BE_GOOD) is None
    back = np.diag([-1.0, -1.0, 1.0]) @ R
    assert found.contradicted_orientation(back, yaw_known=True) == "forward"
    assert found.contradicted_orientation(back, yaw_known=False) is None


@pytest.mark.parametrize(
    ("ahead", "back", "is_known"), [(12, 0, True), (2, 0, False), (12, 3, True), (3, 12, False)]
)
def test_a_reverse_signal_shows_what_is_ahead_where_most_of_the_way_is_without_it(
    ahead, back, is_known
):
    found = Alternatives(joint_settings())
    for k in range(ahead + back):
        one = block(k, speed=5.0 if k >= back else -5.0)
        found.take_block([one], R, np.zeros(3), (1.0, 1.0), {*ALONE, "reverse"}, 0.0)
    assert found._knows_forward == is_known


@pytest.mark.parametrize(("speed", "is_known"), [(12.0, True), (-12.0, False)])
def test_only_a_fast_speed_ahead_shows_what_is_ahead(speed, is_known):
    found = Alternatives(joint_settings())
    found.take_block([block(0, speed=speed)], R, np.zeros(3), (1.0, 1.0), set(ALONE), 0.0)
    assert found._knows_forward == is_known


def test_a_mount_that_a_person_states_counts_where_it_is_the_one_found():
    for stated, is_excluded in ((R, True), (np.diag([-1.0, 1.0, -1.0]) @ R, False)):
        found = Alternatives(joint_settings())
        found.take_mount(stated)
        found.take_block([block(0)], R, np.zeros(3), (1.0, 1.0), set(ALONE), 0.0)
        assert found.is_mirror_excluded == is_excluded


def test_a_block_counts_for_no_more_than_a_few_and_a_sum_can_turn():
    pair, turning = Mirrored(0.01), 0.2 * np.sin(np.linspace(0.0, 6.0, BLOCK_TICKS))
    for _ in range(200):
        pair.add_signals(turning, turning, YES)
    assert pair.is_seen(TO_BE_FINE)
    for _ in range(40):
        pair.add_signals(turning, -turning, YES)
    assert pair.sum < -TO_ACCUSE
    assert math.isfinite(pair.sum)
