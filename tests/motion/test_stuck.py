"""A speed that is stuck against sound ones of every resolution and cycle."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from imucald.motion import ticks as tk
from imucald.motion.stuck import StuckSpeed
from imucald.motion.ticks import empty_rows
from imucald.mount.signal_blocks import BEFORE, BLOCK_TICKS, KEEP

TICKS = 6000


def true_speed(seed: int = 1) -> NDArray[np.float64]:
    """Ten minutes of driving between 7 and 23 m/s, five waves of 0.15 m/s^2 each."""
    rng = np.random.default_rng(seed)
    omega = 2.0 * np.pi * np.array([0.006, 0.011, 0.023, 0.05, 0.11])
    phase = np.arange(TICKS)[:, None] * 0.1 * omega + rng.uniform(0.0, 6.28, 5)
    return np.asarray(15.0 + (0.15 / omega * np.sin(phase)).sum(axis=1))


def flagged(speed: NDArray[np.float64]) -> NDArray[np.bool_]:
    """What block after block is said to be stuck; NaN: no sample in the tick."""
    rows = empty_rows(len(speed) + KEEP)
    rows[KEEP:, tk.SPEED.mean] = speed
    rows[KEEP:, tk.SPEED.n] = np.isfinite(speed)
    watch, out = StuckSpeed(), np.zeros(len(rows), dtype=bool)
    for first in range(0, len(rows) - KEEP - BLOCK_TICKS + 1, BLOCK_TICKS):
        flags = watch.flags(rows[first : first + KEEP + BLOCK_TICKS], BLOCK_TICKS)
        out[first + BEFORE : first + BEFORE + BLOCK_TICKS] = flags[BEFORE : BEFORE + BLOCK_TICKS]
    return out[KEEP:]


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [3, 8, 60])
def test_a_stuck_speed_is_flagged_from_its_first_tick_to_its_last(seconds):
    speed = np.round(true_speed() / 0.0028) * 0.0028
    stuck = slice(3000, 3000 + 10 * seconds)
    speed[stuck] = speed[3000]
    found = np.flatnonzero(flagged(speed))
    assert found[0] <= 3001
    assert found[-1] >= stuck.stop - 2
    assert len(found) <= 10 * seconds + 2


def test_a_tick_of_which_half_is_stuck_is_flagged_as_well():
    speed = np.round(true_speed() / 0.0028) * 0.0028
    speed[3000:3080] = speed[3000]
    speed[3080] = 0.5 * (speed[3000] + speed[3081])
    assert flagged(speed)[3000:3081].all()


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
    speed[3000:3200:10] = speed[3000]
    assert flagged(speed)[3000:3191:10].sum() >= 19


def test_whole_kilometres_an_hour_once_a_second_are_not_stuck():
    """As of a vehicle's diagnosis; a value rounded otherwise now and then splits the steps."""
    speed = np.full(TICKS, np.nan)
    whole = np.round(true_speed()[::10] * 3.6) / 3.6
    speed[::10] = np.round(whole, 2) + np.where(np.arange(TICKS // 10) % 37 == 0, 0.01, 0.0)
    assert not flagged(speed).any()


def test_standing_is_not_being_stuck():
    speed = np.round(true_speed() / 0.0028) * 0.0028
    speed[3000:3600] = 0.0
    assert not flagged(speed).any()


def test_a_speed_that_never_changed_is_not_called_stuck():
    """A simulated or configured constant: there is nothing to hold it against."""
    assert not flagged(np.full(TICKS, 12.0)).any()
