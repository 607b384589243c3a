"""A coarse speed says when it passes the middle between two of its steps."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from imucald.motion.coarse_speed import comes_in, passages, stays, step_of
from imucald.motion.ticks import TICK_S

KMH = 1.0 / 3.6


def driven() -> NDArray[np.float64]:
    """A minute at 1 kHz: up to 15 m/s, a while at that, slowly on, and down to a stop."""
    t = np.arange(60000) * 0.001
    knots = (0.0, 5.0, 18.0, 25.0, 40.0, 50.0, 60.0)
    return np.interp(t, knots, (0.0, 0.0, 15.0, 15.0, 17.0, 0.0, 0.0))


def ticks(true: NDArray[np.float64], step: float, hz: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean times and speeds of ticks, of samples in steps at so many a second."""
    at = np.arange(0, len(true), 1000 // hz)
    each = hz // 10
    speed = np.round(true[at] / step) * step
    return (0.001 * at).reshape(-1, each).mean(axis=1), speed.reshape(-1, each).mean(axis=1)


@pytest.mark.parametrize("step", [0.5 * KMH, KMH])
@pytest.mark.parametrize("hz", [10, 50, 100])
def test_the_change_of_a_coarse_speed_is_that_of_the_vehicle(step: float, hz: int) -> None:
    true = driven()
    t, coarse = ticks(true, step, hz)
    grid = np.arange(0.5, 59.0, TICK_S)
    truth = np.gradient(np.interp(grid, 0.001 * np.arange(len(true)), true), TICK_S)

    def left(times: np.ndarray, values: np.ndarray) -> float:
        change = np.gradient(np.interp(grid, times, values), TICK_S) - truth
        return float(np.sqrt((change * change).mean()))

    less = 0.75 if hz == 10 else 0.5  # a tenth of a second is all that 10 Hz says of the time
    assert left(*passages(t, coarse, step)) < less * left(t, coarse)
    speed = np.interp(grid, *passages(t, coarse, step))
    assert np.abs(speed - np.interp(grid, 0.001 * np.arange(len(true)), true)).max() < step


def test_standstill_stays_standstill() -> None:
    t, coarse = ticks(driven(), KMH, 50)
    parked = np.interp(np.arange(0.0, 4.5, TICK_S), *passages(t, coarse, KMH))
    assert (parked == 0.0).all()


def test_a_fine_speed_and_a_slow_one_stay_as_they_are() -> None:
    for step, hz in ((0.0028, 50), (KMH, 10)):
        t, speed = ticks(driven(), step, hz)
        if hz == 10:  # seldom, and by many steps each time
            t, speed = t[100:180:20], speed[100:180:20]
        assert [x.tolist() for x in passages(t, speed, step)] == [t.tolist(), speed.tolist()]


def test_the_step_is_that_between_speeds_that_stay() -> None:
    _, speed = ticks(driven(), KMH, 50)
    assert step_of(speed) == pytest.approx(KMH)
    assert step_of(np.arange(10.0)) == 0.0
    assert stays(np.array([[0.0, 0.0, 1.0], [2.0, 2.0, 1.0]])).tolist() == [False, True]


@pytest.mark.parametrize("hz", [50, 100])
def test_a_speed_that_noise_takes_to_and_fro_passes_where_most_of_its_samples_do(hz: int) -> None:
    rng = np.random.default_rng(4)
    t = np.arange(60000) * 0.001
    true = 10.5 * KMH + 0.06 * np.sin(0.5 * t)
    when, coarse = ticks(true + 0.03 * rng.standard_normal(len(t)), KMH, hz)
    passed, speed = passages(when, coarse, KMH)
    inner = slice(1, -1)
    assert np.abs(speed[inner] - 10.5 * KMH).max() < 1e-9
    assert np.abs(np.interp(passed[inner], t, true) - 10.5 * KMH).max() < 0.03


def test_a_step_is_known_by_the_sums_of_samples_whatever_a_tick_holds_of_two_steps() -> None:
    rng = np.random.default_rng(4)
    speed = np.round((10.5 * KMH + 0.03 * rng.standard_normal((60, 5))) / KMH) * KMH
    counts = np.full(60, 5)
    assert comes_in(KMH, speed.mean(axis=1), counts)
    assert not comes_in(2.0 * KMH, speed.mean(axis=1), counts)
    assert not comes_in(KMH, 3.0 + 0.03 * rng.standard_normal(60), counts)
