"""Signal health: which ticks of which signal and axis are not to be trusted."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imucald.core.samples import GRAVITY
from imucald.motion.physical_limits import is_plausible, is_saturated, saturated_axes
from imucald.motion.signal_health import SignalFault, SignalHealth
from imucald.motion.standstill import is_idle, keeps_steady
from imucald.motion.stuck import HELD_TICKS, HeldForce
from imucald.motion.ticks import ACCEL, GYRO, SPEED, WHEEL_SPREAD, empty_rows

N = 64
YES = np.ones(N, dtype=bool)


def drive(seed: int = 0) -> np.ndarray:
    """Ticks of a sound sensor in a vehicle at 10 m/s (N, COLUMNS)."""
    rng = np.random.default_rng(seed)
    rows = empty_rows(N)
    force = np.array([0.0, 0.0, GRAVITY]) + 0.1 * rng.standard_normal((N, 3))
    rows[:, ACCEL.n] = rows[:, GYRO.n] = rows[:, SPEED.n] = 10.0
    rows[:, ACCEL.x : ACCEL.z + 1] = force
    rows[:, ACCEL.min_x : ACCEL.min_z + 1] = force - 0.2
    rows[:, ACCEL.max_x : ACCEL.max_z + 1] = force + 0.2
    rows[:, GYRO.x : GYRO.z + 1] = 0.01 * rng.standard_normal((N, 3))
    rows[:, (ACCEL.age, GYRO.age, SPEED.age)] = 0.05
    rows[:, SPEED.mean] = 10.0 + 0.05 * rng.standard_normal(N)
    return rows


def untrusted(health: SignalHealth, rows: np.ndarray, turning: float = 0.0) -> np.ndarray:
    force, speed = rows[:, ACCEL.x : ACCEL.z + 1], rows[:, SPEED.mean]
    return health.untrusted(rows, force, YES, speed, YES, np.full(N, turning))


def health(full_scale: float = math.inf) -> SignalHealth:
    return SignalHealth(slice(0, N), full_scale)


def test_a_sound_drive_is_trusted_throughout() -> None:
    sound, rows = health(30.0), drive()
    sound.drop_impossible(rows)
    assert not any(sound.stuck(name, rows).any() for name in ("accel", "gyro"))
    assert not sound.stuck_speed(rows, lambda: None).any()
    assert not untrusted(sound, rows, 0.5).any()
    assert not sound.counts


@pytest.mark.parametrize("axis", range(3))
def test_saturation_is_found_axis_by_axis_and_taken_with_its_neighbours(axis: int) -> None:
    clipping, rows = health(30.0), drive()
    rows[20, ACCEL.max_x + axis] = 29.9
    rows[40, ACCEL.min_x + axis] = -29.9
    bad = untrusted(clipping, rows)
    found = clipping.found["accel", SignalFault.SATURATED]
    assert np.argwhere(found).tolist() == [[20, axis], [40, axis]]
    assert np.flatnonzero(bad).tolist() == [*range(17, 24), *range(37, 44)]
    assert clipping.counts == {("accel", "saturated"): 2}


def test_a_rejected_sample_counts_as_saturated_on_all_axes() -> None:
    rows = drive()
    rows[10, ACCEL.bad] = 1.0
    assert saturated_axes(rows, math.inf)[10].all()
    assert saturated_axes(rows, math.inf).sum() == 3


def test_what_no_road_vehicle_does_is_found_by_signal() -> None:
    wild, rows = health(), drive()
    rows[5, ACCEL.x : ACCEL.z + 1] = (0.0, 0.0, 0.2 * GRAVITY)
    rows[30:, SPEED.mean] += 20.0
    bad = untrusted(wild, rows)
    assert np.flatnonzero(wild.found["accel", SignalFault.IMPLAUSIBLE]).tolist() == [5]
    assert np.flatnonzero(wild.found["speed", SignalFault.SPEED_JUMP]).tolist() == [29, 30]
    assert not wild.found["gyro", SignalFault.IMPLAUSIBLE].any()
    assert np.flatnonzero(bad).tolist() == [5, *range(19, 41)]
    assert untrusted(wild, drive(), 5.0).all(), "turning faster than any road vehicle"


def test_wheels_may_differ_in_a_curve_but_not_on_the_straight() -> None:
    slipping, rows = health(), drive()
    rows[:, WHEEL_SPREAD.n] = 10.0
    rows[:, WHEEL_SPREAD.mean] = 1.5
    assert not untrusted(slipping, rows, 0.5).any()
    assert untrusted(slipping, rows).all()
    assert slipping.counts == {("wheel_speeds", "wheel_slip"): N}


@pytest.mark.parametrize("number", [math.nan, math.inf, -500.0])
def test_an_impossible_number_empties_only_its_own_sensor(number: float) -> None:
    sick, rows = health(), drive()
    rows[7, ACCEL.y] = number
    sick.drop_impossible(rows)
    assert rows[7, ACCEL.n] == 0.0
    assert rows[7, GYRO.n] == rows[7, SPEED.n] == 10.0
    assert rows[8, ACCEL.n] == 10.0
    assert sick.counts == {("accel", "impossible"): 1}


def test_a_frozen_sensor_in_a_moving_vehicle_is_stuck_and_the_other_is_not() -> None:
    frozen, rows = health(), drive()
    rows[30:, GYRO.x : GYRO.z + 1] = rows[30, GYRO.x : GYRO.z + 1]
    assert np.flatnonzero(frozen.stuck("gyro", rows)).tolist() == [*range(30, N)]
    assert not frozen.stuck("accel", rows).any()
    assert frozen.found["gyro", SignalFault.STUCK][30:].all()
    frozen.restart()
    assert not frozen.found


def test_a_force_that_never_moves_is_held_after_a_second() -> None:
    held, row = HeldForce(), drive()[0].copy()
    row[ACCEL.min_x] = row[ACCEL.max_x] = row[ACCEL.x]
    force = (float(row[ACCEL.x]), float(row[ACCEL.y]), float(row[ACCEL.z]))
    said = [held.take_tick(row.tolist(), force) for _ in range(HELD_TICKS + 2)]
    assert said == [False] * HELD_TICKS + [True, True]
    assert not held.take_tick(row.tolist(), (force[0] + 0.01, force[1], force[2]))


def test_one_tick_and_many_agree_on_saturation() -> None:
    rows = drive()
    rows[::3, ACCEL.max_z] = 29.5
    one = [is_saturated(row, 30.0) for row in rows.tolist()]
    assert one == saturated_axes(rows, 30.0).any(axis=1).tolist()
    assert any(one)
    assert not all(one)


def test_rest_is_distinguished_from_driving_by_what_a_sensor_feels() -> None:
    rng = np.random.default_rng(1)
    rate, force = 0.005 * rng.standard_normal((N, 3)), 0.05 * rng.standard_normal((N, 3))
    assert is_idle(rate, force)
    assert not is_idle(rate + np.linspace(0.0, 0.3, N)[:, None], force), "a turn"
    assert not is_idle(rate, force + np.linspace(0.0, 3.0, N)[:, None]), "moving off"
    noisy = 0.4 * rng.standard_normal((N, 3))
    assert is_idle(rate, noisy), "a noisy sensor rests as well"
    half = np.concatenate([force[:32], 10.0 * force[32:]])
    assert keeps_steady(half, 0.1, 32).tolist() == [True] * 32 + [False] * 32


def test_a_sample_that_no_sensor_gives_is_not_plausible() -> None:
    assert is_plausible("gyro", (1.0, -2.0, 3.0))
    for bad in (math.nan, math.inf, 1e5):
        assert not is_plausible("gyro", (0.0, bad, 0.0))
