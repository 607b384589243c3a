"""A speed that is stuck against sound ones of every resolution and cycle."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from imucald.motion import ticks as tk
from imucald.motion.signal_health import SignalHealth
from imucald.motion.stuck import SeenForward
from imucald.motion.ticks import empty_rows
from imucald.mount.signal_blocks import BEFORE, BLOCK_TICKS, KEEP

TICKS = 6000


def true_speed(seed: int = 1) -> NDArray[np.float64]:
    """Ten minutes of driving between 7 and 23 m/s, five waves of 0.15 m/s^2 each."""
    rng = np.random.default_rng(seed)
    omega = 2.0 * np.pi * np.array([0.006, 0.011, 0.023, 0.05, 0.11])
    phase = np.arange(TICKS)[:, None] * 0.1 * omega + rng.uniform(0.0, 6.28, 5)
    return np.asarray(15.0 + (0.15 / omega * np.sin(phase)).sum(axis=1))


def flagged(
    speed: NDArray[np.float64],
    true: NDArray[np.float64] | None = None,
    off: float = 0.0,
    late: float = 0.0,
) -> NDArray[np.bool_]:
    """What block after block is said to be stuck; NaN: no sample in the tick.

    true: what the vehicle drives, of which the force tells; off: the force by so much [m/s^2].
    late: the speed, behind the force [s].
    """
    rows = empty_rows(len(speed) + KEEP)
    rows[KEEP:, tk.SPEED.mean] = speed
    rows[KEEP:, tk.SPEED.n] = np.isfinite(speed)
    accel = np.zeros(len(rows))
    accel[KEEP:] = off + np.gradient(true_speed() if true is None else true, 0.1)
    health = SignalHealth(slice(BEFORE, BEFORE + BLOCK_TICKS))
    out = np.zeros(len(rows), dtype=bool)
    for first in range(0, len(rows) - KEEP - BLOCK_TICKS + 1, BLOCK_TICKS):
        part = slice(first, first + KEEP + BLOCK_TICKS)
        seen = SeenForward(accel[part], late, 0.05, 0.3)
        flags = health.stuck_speed(rows[part], lambda seen=seen: seen)
        out[first + BEFORE : first + BEFORE + BLOCK_TICKS] = flags[BEFORE : BEFORE + BLOCK_TICKS]
    return out[KEEP:]


def braking() -> NDArray[np.float64]:
    """Ten minutes at 20 m/s, every half minute slowed down to 8 m/s for a while at 2 m/s^2."""
    t = np.arange(TICKS) * 0.1 % 30.0
    return np.asarray(20.0 - 2.0 * np.clip(np.minimum(t - 12.0, 27.0 - t), 0.0, 6.0))


@pytest.mark.parametrize("step", [0.0028, 0.028, 0.28])
@pytest.mark.parametrize("seconds", [8, 20, 60])
def test_a_speed_that_is_stuck_while_the_vehicle_brakes_is_flagged(step: float, seconds: int):
    sound = np.round(braking() / step) * step
    speed = sound.copy()
    stuck = slice(3124, 3124 + 10 * seconds)  # in front of the braking
    speed[stuck] = speed[3123]
    found = np.flatnonzero(flagged(speed, braking()))
    assert 3120 <= found[0] <= 3124 + BLOCK_TICKS, "it is flagged from the next block on at least"
    assert found[-1] >= stuck.stop - 2
    assert len(found) <= 10 * seconds + 3
    assert not flagged(sound, braking()).any()


def test_a_tick_of_which_half_is_stuck_is_flagged_as_well():
    speed = np.round(braking() / 0.0028) * 0.0028
    speed[3124:3204] = speed[3123]
    speed[3204] = 0.5 * (speed[3123] + speed[3205])
    assert flagged(speed, braking())[3190:3205].all()


def test_a_speed_that_stays_while_nothing_happens_is_not_stuck():
    """A bench, a HIL, a cruise control: exactly the same for minutes between manoeuvres."""
    t = np.arange(TICKS) * 0.1 % 60.0
    true = 14.0 + np.clip(np.minimum(t - 40.0, 60.0 - t), 0.0, 5.0)
    for step in (1e-4, 0.0028, 0.28):
        assert not flagged(np.round(true / step) * step, true).any()
        assert not flagged(np.round(true / step) * step, true, off=0.25).any(), "a slope"


@pytest.mark.parametrize("late", [3, 7, 12])
def test_a_late_speed_is_not_stuck(late: int):
    true = braking()
    step = 1.0 / 3.6
    speed = np.round(true[np.maximum(np.arange(TICKS) - late, 0)] / step) * step
    assert not flagged(speed, true, late=0.1 * late).any()


@pytest.mark.slow
@pytest.mark.parametrize("step", [0.0028, 0.028, 0.28, 1.0])
def test_a_sound_speed_is_not_flagged_however_coarse(step):
    assert not flagged(np.round(true_speed() / step) * step).any()


@pytest.mark.parametrize("held", [5, 10, 30])
def test_a_sender_that_repeats_its_values_is_not_flagged(held):
    speed = np.repeat(true_speed()[::held], held)[:TICKS]
    assert not flagged(speed).any()


def test_a_slow_sender_is_not_flagged_but_its_stuck_value_is():
    speed = np.full(TICKS, np.nan)
    speed[::10] = np.round(true_speed()[::10] / 0.01) * 0.01
    assert not flagged(speed).any()
    speed[::10] = braking()[::10]
    assert not flagged(speed, braking()).any()
    speed[3120:3320:10] = speed[3120]
    assert flagged(speed, braking())[3180:3311:10].sum() >= 13


def test_whole_kilometres_an_hour_once_a_second_are_not_stuck():
    """As of a vehicle's diagnosis; a value rounded otherwise now and then splits the steps."""
    speed = np.full(TICKS, np.nan)
    whole = np.round(true_speed()[::10] * 3.6) / 3.6
    speed[::10] = np.round(whole, 2) + np.where(np.arange(TICKS // 10) % 37 == 0, 0.01, 0.0)
    assert not flagged(speed).any()


def stopping() -> NDArray[np.float64]:
    """Ten minutes of driving with a stop of a minute, at 2 m/s^2 from and to some 15 m/s."""
    t = np.arange(TICKS) * 0.1
    limit = 2.0 * np.clip(np.abs(t - 330.0) - 30.0, 0.0, None)
    return np.asarray(np.minimum(true_speed(), limit))


@pytest.mark.parametrize("dead", [0.0, 0.5, 1.4])
@pytest.mark.parametrize("cycle", [1, 10, 20])
@pytest.mark.parametrize("late", [0, 12])
def test_standing_is_not_being_stuck(dead: float, cycle: int, late: int):
    true = stopping()
    late_speed = true[np.maximum(np.arange(TICKS) - late, 0)]
    speed = np.full(TICKS, np.nan)
    speed[::cycle] = np.where(late_speed < dead, 0.0, np.round(late_speed / 0.0028) * 0.0028)[
        ::cycle
    ]
    assert not flagged(speed, true, late=0.1 * late).any()


@pytest.mark.parametrize("step", [0.0028, 0.28])
def test_a_speed_that_falls_to_zero_on_a_cruise_is_stuck_from_then_on(step: float):
    speed = np.round(braking() / step) * step
    cruise = slice(3010, 3610)
    speed[cruise] = 0.0
    assert flagged(speed, braking())[cruise].all()
    assert flagged(speed, braking()).sum() <= 602


def test_a_speed_that_stays_zero_in_a_launch_is_stuck():
    true, speed = stopping(), np.round(stopping() / 0.0028) * 0.0028
    speed[3500:4200] = 0.0
    found = flagged(speed, true)
    assert found[3680:4200].all()
    assert not found[:3500].any()


def test_a_value_that_drops_out_makes_the_next_ones_not_stuck():
    true = np.full(TICKS, 20.0)
    true[:1500] = braking()[:1500]
    speed = np.round(true / 0.28) * 0.28
    speed[3000:3005] = 0.0
    assert not flagged(speed, true).any()


def test_a_speed_that_never_changed_is_not_called_stuck():
    """A simulated or configured constant: nobody knows how it usually changes."""
    assert not flagged(np.full(TICKS, 12.0)).any()


def test_where_no_mount_is_known_nothing_is_called_stuck():
    rows = empty_rows(KEEP + BLOCK_TICKS)
    rows[:, tk.SPEED.mean], rows[:, tk.SPEED.n] = 12.0, 5
    assert not SignalHealth(slice(0, BLOCK_TICKS)).stuck_speed(rows, lambda: None).any()


def flagged_with_wheels(speed: NDArray[np.float64], wheels: NDArray[np.float64]) -> np.ndarray:
    """At which ticks the speed is stuck; wheels: (N, 4), their speeds as the bus has them."""
    rows = empty_rows(len(speed) + KEEP)
    rows[KEEP:, tk.SPEED.mean], rows[KEEP:, tk.WHEEL_SPREAD.mean] = speed, np.ptp(wheels, axis=1)
    rows[KEEP:, tk.SPEED.n] = rows[KEEP:, tk.WHEEL_SPREAD.n] = 5
    health = SignalHealth(slice(BEFORE, BEFORE + BLOCK_TICKS))
    out = np.zeros(len(rows), dtype=bool)
    for first in range(0, len(rows) - KEEP - BLOCK_TICKS + 1, BLOCK_TICKS):
        flags = health.stuck_speed(rows[first : first + KEEP + BLOCK_TICKS], lambda: None)
        out[first + BEFORE : first + BEFORE + BLOCK_TICKS] = flags[BEFORE : BEFORE + BLOCK_TICKS]
    return out[KEEP:]


def launches(step: float, least: float = 0.0) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Speed, and wheels, of two minutes: 20 s of standing and 40 s of driving, twice.

    step: of both [m/s]. least: below, wheels and speed are silent [m/s].
    """
    t = np.arange(1200) * 0.1
    true = np.clip(np.minimum(t % 60.0 - 20.0, 60.0 - t % 60.0), 0.0, 12.0 + np.sin(0.3 * t))
    bend = 0.3 * np.sin(0.4 * t) * np.array([[1.0], [-1.0], [0.9], [-0.9]])
    noise = 0.02 * np.random.default_rng(1).standard_normal((4, len(t)))
    wheels = np.where(true > least, true + (true > 0.0) * (bend + noise), 0.0).T
    return np.round(np.where(true > least, true, 0.0) / step) * step, np.round(wheels / step) * step


@pytest.mark.parametrize("step", [0.003, 0.01, 0.03])
def test_a_speed_that_stays_zero_while_the_wheels_turn_is_stuck(step: float) -> None:
    speed, wheels = launches(step)
    speed[700:] = 0.0
    found = flagged_with_wheels(speed, wheels)
    end = len(found) - len(found) % BLOCK_TICKS - KEEP
    assert not found[:790].any()
    assert found[810:end].mean() > 0.95
    standing = flagged_with_wheels(np.zeros(1200), np.zeros((1200, 4)))
    assert not standing.any()


@pytest.mark.parametrize("step", [0.003, 0.03, 0.3])
@pytest.mark.parametrize("least", [0.0, 1.1])
def test_stops_and_launches_of_a_sound_speed_are_not_stuck(step: float, least: float) -> None:
    assert not flagged_with_wheels(*launches(step, least)).any()


def test_a_speed_that_begins_later_than_the_wheels_is_not_stuck() -> None:
    speed, wheels = launches(0.01)
    assert not flagged_with_wheels(np.where(speed < 1.1, 0.0, speed), wheels).any()


def test_wheels_that_differ_while_they_stand_accuse_nothing() -> None:
    offsets = np.tile([0.0, 0.1, 0.2, 0.0], (1200, 1))
    assert not flagged_with_wheels(np.zeros(1200), offsets).any()
