"""A sensor that is turned or tilted by hand: alone while driving, and while the vehicle stands."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imucald.core.rotations import rotation_from_angles
from imucald.core.samples import GRAVITY, Samples, Series
from imucald.motion.column_ticks import ticks_from_samples
from imucald.mount.estimate import MountState
from imucald.mount.estimator import JointEstimator
from imucald.mount.hand_moves import (
    FORCE,
    LATE_TICKS,
    YAW_RATE,
    HandMove,
    HandMoves,
    TurnedAlone,
)
from imucald.mount.hysteresis import GOOD
from imucald.mount.signal_blocks import BLOCK_TICKS, SignalBlockMaker
from imucald.simulation import Drive, random_model, simulate
from mount_settings import joint_settings
from signal_block import block

T = np.arange(BLOCK_TICKS) * 0.1
ALL = np.ones(BLOCK_TICKS, dtype=bool)
NONE = np.zeros(BLOCK_TICKS)


# turned alone ----------------------------------------------------------------------------------


def knock(at: float, degrees: float, t: np.ndarray = T) -> np.ndarray:
    """Rate of a turn within half a second [rad/s]."""
    return np.where((at - 0.01 < t) & (t < at + 0.49), math.radians(degrees) / 0.5, 0.0)


@pytest.mark.parametrize("at", [3.0, 6.0])
def test_a_sensor_that_is_knocked_while_driving_straight_is_reported(at: float) -> None:
    """Also where the knock lies across the end of a block."""
    alone = TurnedAlone()
    assert alone.take_rates(NONE, NONE, ALL) == 0.0
    rates = knock(at, -4.0, np.arange(3 * BLOCK_TICKS) * 0.1).reshape(3, BLOCK_TICKS)
    found = [alone.take_rates(rate, NONE, ALL) for rate in rates]
    assert sum(found) == pytest.approx(math.radians(-4.0), rel=0.01)
    assert alone.take_rates(NONE, NONE, ALL) == 0.0


def test_bends_of_a_vehicle_whose_yaw_rate_is_late_and_ten_percent_off_are_none() -> None:
    alone = TurnedAlone()
    for k in range(6):
        bend = 0.6 * np.exp(-(((T - 1.0 - 0.8 * k) / 0.4) ** 2))
        late = 0.6 * np.exp(-(((T - 1.2 - 0.8 * k) / 0.4) ** 2))
        assert alone.take_rates(bend, 1.1 * late, ALL) == 0.0


def test_a_gust_that_pushes_the_vehicle_is_none() -> None:
    """The force says 9 deg, the gyroscope none."""
    alone = TurnedAlone()
    assert alone.take_rates(NONE, knock(3.0, 9.0), ALL, FORCE) == 0.0
    assert alone.take_rates(knock(3.0, 9.0), NONE, ALL, FORCE) == pytest.approx(
        math.radians(9.0), rel=0.01
    )


@pytest.mark.parametrize(("std_deg", "found"), [(0.0, True), (1.2, False)])
def test_a_zero_that_was_guessed_badly_turns_no_sensor(std_deg: float, found: bool) -> None:
    """A drive that begins on a motorway: the zero of the rate is 1.7 deg/s off, and known so."""
    rate = np.tile([0.0, 0.0, math.radians(1.7)], (BLOCK_TICKS, 1))
    one = block(0.0, rate=rate, turn_zero_std=math.radians(std_deg))
    change = HandMoves().while_driving(one, np.eye(3), rate[:, 2], NONE, has_yaw_rate=True)
    assert (change is not None) == found


def test_a_better_guess_of_the_zero_turns_no_sensor() -> None:
    """The rates before it, which the next block is compared with, had the former zero taken off."""
    moves, zeros = HandMoves(), np.radians([-1.7, 0.0])
    for k, (zero, std_deg) in enumerate(zip(zeros.tolist(), (1.2, 0.03), strict=True)):
        bias, rate = np.array([0.0, 0.0, zero]), np.tile([0.0, 0.0, -zero], (BLOCK_TICKS, 1))
        std = {"gyro_bias": bias, "turn_zero_std": math.radians(std_deg)}
        one = block(6.4 * k, rate=rate, **std)
        assert moves.while_driving(one, np.eye(3), rate[:, 2], NONE, has_yaw_rate=True) is None


def test_a_jolt_that_comes_back_is_none() -> None:
    alone = TurnedAlone()
    assert alone.take_rates(knock(2.0, 20.0) + knock(2.5, -20.0), NONE, ALL) == 0.0


def test_nothing_is_held_against_what_was_before_a_hole() -> None:
    alone = TurnedAlone()
    ok = ALL & (np.abs(T - 3.2) > 0.3)
    assert alone.take_rates(knock(3.0, 10.0), NONE, ok) == 0.0
    assert math.radians(10.0) > YAW_RATE.least


# while the vehicle stands ----------------------------------------------------------------------


def standing(
    tilt_deg: np.ndarray,
    ahead: np.ndarray,
    rest: np.ndarray,
    yaw_rate_deg: float = 0.0,
    least_speed: float = 0.0,
    noise: float = 0.0,
) -> list[HandMove]:
    """What is found in blocks of ticks (N,) with a sensor that pitches and a force ahead."""
    found, detector = [], HandMoves()
    tilt = np.radians(tilt_deg)
    down = GRAVITY * np.sin(tilt) + ahead
    force = np.stack([down, 0.0 * down, GRAVITY * np.cos(tilt)], axis=1)
    force += noise * np.random.default_rng(6).standard_normal(force.shape)
    rate = np.tile([0.0, 0.0, math.radians(yaw_rate_deg)], (len(tilt), 1))
    for k in range(0, len(tilt), BLOCK_TICKS):
        part = slice(k, k + BLOCK_TICKS)
        one = block(0.1 * k, force=force[part], rate=rate[part], rest=rest[part], speed=NONE)
        one.least_speed = least_speed
        change = detector.while_standing(one, np.eye(3))
        found += [] if change is None else [change]
    return found


STOOD = 4 * BLOCK_TICKS
TICKS = np.arange(STOOD)
STANDS = TICKS >= 20


@pytest.mark.parametrize("moves_off", [3 * BLOCK_TICKS - 6, 3 * BLOCK_TICKS, 3 * BLOCK_TICKS - 20])
def test_a_vehicle_that_moves_off_before_its_speed_says_so_tilts_no_sensor(moves_off: int) -> None:
    ahead = 1.5 * ((moves_off <= TICKS) & (moves_off + 60 > TICKS))
    rest = STANDS & (moves_off + LATE_TICKS > TICKS)
    assert not standing(np.zeros(STOOD), ahead, rest)


@pytest.mark.parametrize("at", [70, 90, 120, 127, 140])
def test_a_sensor_that_is_tilted_while_standing_is_reported_within_ten_seconds(at: int) -> None:
    (found,) = standing(5.0 * (at <= TICKS), np.zeros(STOOD), STANDS)
    assert found.axis == 1
    assert abs(math.degrees(found.size)) == pytest.approx(5.0, abs=0.1)
    within = BLOCK_TICKS * (at // BLOCK_TICKS + 2)
    assert standing((5.0 * (at <= TICKS))[:within], NONE[:1].repeat(within), STANDS[:within])


def test_a_vehicle_that_creeps_while_its_speed_says_zero_tilts_no_sensor() -> None:
    """In a queue, up to 3.6 km/h, at 0.6 m/s^2."""
    ahead = 0.6 * ((TICKS >= 110) & (TICKS < 126)) - 0.6 * ((TICKS >= 142) & (TICKS < 158))
    assert not standing(np.zeros(STOOD), ahead, STANDS, least_speed=1.0)
    assert standing(12.0 * (TICKS >= 90), ahead, STANDS, least_speed=1.0), "no car creeps so"


def test_shaking_tilts_no_sensor() -> None:
    none = np.zeros(50 * BLOCK_TICKS)
    assert not standing(none, none, none == 0.0, noise=0.5)
    (found,) = standing(10.0 * (np.arange(len(none)) >= 640), none, none == 0.0, noise=0.5)
    assert found.axis == 1


def test_two_stops_on_different_slopes_are_no_tilt() -> None:
    rest = STANDS & ((TICKS < 100) | (TICKS >= 150))
    assert not standing(5.0 * (TICKS >= 125), np.zeros(STOOD), rest)


def test_a_sensor_that_turns_about_the_vertical_while_standing_is_reported() -> None:
    turned = standing(np.zeros(STOOD), np.zeros(STOOD), STANDS, yaw_rate_deg=2.0)
    assert turned
    assert {one.axis for one in turned} == {2}


def test_a_vehicle_that_creeps_round_a_bend_turns_no_sensor() -> None:
    """A speed that begins at 3 km/h says zero while a car in a queue turns by 2 deg/s."""
    none = np.zeros(STOOD)
    assert not standing(none, none, STANDS, yaw_rate_deg=2.0, least_speed=0.83)
    assert standing(none, none, STANDS, yaw_rate_deg=14.0, least_speed=0.83), "no car is so tight"
    assert standing(none, none, STANDS, yaw_rate_deg=2.0, least_speed=0.05)


@pytest.mark.parametrize(("begins_at", "least"), [(0.83, 0.83), (0.0, 0.1), (3.0, 1.0)])
def test_how_slow_a_vehicle_goes_unseen_is_learnt_from_its_speed(
    begins_at: float, least: float
) -> None:
    """Launches and stops at 1 m/s^2; what begins later than wheel sensors do is not believed."""
    t = np.arange(0.0, 120.0, 0.02)
    shown = 6.0 - np.abs(t % 20.0 - 10.0)
    shown[shown < max(begins_at, 1e-9)] = 0.0
    samples = {
        "accel": Series(t, np.tile([0.0, 0.0, GRAVITY], (len(t), 1))),
        "speed": Series(t, shown),
    }
    maker, found = SignalBlockMaker(joint_settings()), [1.0]
    for row in ticks_from_samples(samples, 0, 1199, {}).tolist():
        if maker.push(row):
            found.append(maker.block().least_speed)
    assert found[-1] == pytest.approx(least, abs=0.15)
    assert found == sorted(found, reverse=True)


# the whole estimator ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def sound() -> Drive:
    return simulate(random_model(501_000), 501_000, 12.0)


def turned(drive: Drive, start: float, degrees: float) -> Samples:
    """The sensor turned about the vehicle's z from a time on, unseen by the gyroscope."""
    R = drive.truth.R_vehicle_from_sensor()
    a = math.radians(degrees)
    about = np.array([[math.cos(a), -math.sin(a), 0], [math.sin(a), math.cos(a), 0], [0, 0, 1.0]])
    sensor = R.T @ about.T @ R
    out = dict(drive.samples)
    for channel in ("accel", "gyro"):
        one = drive.samples[channel]
        later = one.t >= start
        values = one.values.copy()
        values[later] = values[later] @ sensor.T
        out[channel] = Series(one.t, values)
    return out


def bad_at(samples: Samples, seconds: float) -> list[float]:
    """When the mount became suspect [s]."""
    estimator = JointEstimator()
    times, before = [], MountState.WAITING
    for k, row in enumerate(ticks_from_samples(samples, 0, int(10 * seconds)).tolist()):
        estimator.step(row)
        if estimator.state is MountState.SUSPECT and before is not MountState.SUSPECT:
            times.append(0.1 * k)
        before = estimator.state
    return times


@pytest.mark.parametrize("degrees", [10.0, -6.0])
def test_a_turn_in_yaw_that_no_gyroscope_saw_is_reported_within_a_minute(
    sound: Drive, degrees: float
) -> None:
    assert not bad_at(sound.samples, 480.0)
    times = bad_at(turned(sound, 300.0, degrees), 480.0)
    assert times
    assert 300.0 < times[0] < 370.0


def test_a_sensor_that_is_turned_again_before_it_is_good_again_is_never_wrong_as_good(
    sound: Drive,
) -> None:
    """By hand, seen by the gyroscope: 20 deg, and half a minute later 12 deg back."""
    t = sound.samples["gyro"].t
    angle = np.radians(
        20.0 * np.clip((t - 300.0) / 0.5, 0, 1) - 12.0 * np.clip((t - 330.0) / 0.5, 0, 1)
    )
    R = sound.truth.R_vehicle_from_sensor()
    samples = dict(sound.samples)
    for channel in ("accel", "gyro"):
        one = sound.samples[channel]
        a = np.interp(one.t, t, angle)
        x, y, z = (one.values @ R.T).T
        if channel == "gyro":
            z = z + np.gradient(a, one.t)
        turned_by = np.stack(
            [np.cos(a) * x + np.sin(a) * y, np.cos(a) * y - np.sin(a) * x, z], axis=1
        )
        samples[channel] = Series(one.t, turned_by @ R)
    estimator = JointEstimator()
    good_after = False
    for k, row in enumerate(ticks_from_samples(samples, 0, 7200).tolist()):
        estimator.step(row)
        if k > 3100 and estimator.state in (MountState.USABLE, MountState.FINE):
            good_after = True
            assert estimator.correction is not None
            applied = estimator.correction.matrix()
            now = math.radians(20.0 if 0.1 * k < 330.0 else 8.0)
            ahead = applied @ R.T @ [math.cos(now), -math.sin(now), 0.0]
            assert abs(math.degrees(math.atan2(ahead[1], ahead[0]))) < 2.0, 0.1 * k
    assert good_after


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1840012, 1840013])
def test_a_tilt_of_a_young_mount_is_noticed_without_a_gyroscope(seed: int) -> None:
    """Turned by 12 deg in pitch after 100 s on a motorway: no filter of sudden changes runs."""
    made = simulate(random_model(seed, "motorway"), seed, 3.0)
    R = made.truth.R_vehicle_from_sensor()
    about = rotation_from_angles(0.0, math.radians(12.0), 0.0)
    samples = {name: one for name, one in made.samples.items() if name != "gyro"}
    accel = samples["accel"]
    tilted = np.where((accel.t > 100.0)[:, None], accel.values @ R.T @ about @ R, accel.values)
    samples["accel"] = Series(accel.t, tilted)
    estimator, good = JointEstimator(joint_settings()), []
    for row in ticks_from_samples(samples, 0, 1800).tolist():
        estimator.step(row)
        good.append(estimator.state in GOOD)
    assert good[999]
    assert not all(good[1000:1600])
