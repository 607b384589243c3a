from __future__ import annotations

import numpy as np
import pytest

from imucald.config.calibration import StaticTestSettings
from imucald.core.samples import Series
from imucald.motion.column_ticks import ticks_from_samples
from imucald.motion.ticks import ACCEL
from imucald.mount.method_a.static_test import (
    CONFIRM_TICKS,
    StandstillDetector,
)

G = 9.80665


def rest_ticks(
    seconds: float, shake: float, seed: int = 0, rate: float = 50.0
) -> list[list[float]]:
    """Ticks of a sensor at rest that shakes within +-shake [m/s^2] on each axis."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(seconds * rate)) / rate
    f = np.array([0.3, -0.2, G]) + rng.uniform(-shake, shake, (len(t), 3))
    return ticks_from_samples({"accel": Series(t, f)}, 0, int(seconds * 10)).tolist()


def windows(detector: StandstillDetector, rows: list[list[float]], stopped: bool | None) -> list:
    return [w for row in rows if (w := detector.take_tick(row, stopped)) is not None]


@pytest.mark.parametrize("duration", [0.1, 0.2])
def test_each_axis_is_judged_by_its_own_threshold(duration: float) -> None:
    """0.1, 0.2 and 0.1 apart; a window of a single tick is judged as one of several is."""
    t = np.arange(20) * duration / 20.0
    a = np.zeros((20, 3))
    a[7], a[13] = (0.0, 0.0, 9.75), (0.125, 0.25, 9.875)
    a[:, 2] = np.where(a[:, 2] == 0.0, 9.75, a[:, 2])

    def is_static(*threshold: float) -> bool:
        settings = StaticTestSettings(samples=20, duration=duration, threshold=threshold)
        detector = StandstillDetector(settings)
        ticks = ticks_from_samples({"accel": Series(t, a)}, 0, round(duration * 10))
        windows(detector, ticks.tolist(), None)
        return detector.still

    assert is_static(0.125, 0.25, 0.125)
    assert not is_static(0.1, 0.25, 0.125)
    assert not is_static(0.125, 0.2, 0.125)
    assert not is_static(0.125, 0.25, 0.1)


def test_standstill_is_found_after_the_window_and_its_mean_is_right() -> None:
    detector = StandstillDetector(StaticTestSettings(duration=2.0))
    rows = rest_ticks(2.0, 0.1)
    assert windows(detector, rows, None) == []
    assert detector.still
    found = windows(detector, rest_ticks(1.0, 0.1, seed=1), None)
    assert len(found) == 1
    assert found[0].samples == 100
    assert (found[0].x, found[0].y, found[0].z) == pytest.approx((0.3, -0.2, G), abs=0.03)


def test_a_window_followed_at_once_by_motion_does_not_count() -> None:
    detector = StandstillDetector(StaticTestSettings(duration=2.0))
    assert windows(detector, rest_ticks(2.0, 0.1), True) == []
    for row in rest_ticks(0.1 * (CONFIRM_TICKS - 1), 0.1):
        assert detector.take_tick(row, True) is None
    assert detector.take_tick(rest_ticks(0.1, 0.1)[0], False) is None
    assert not detector.still
    assert windows(detector, rest_ticks(1.0, 0.1), True) == []


def test_shaking_beyond_the_threshold_is_no_standstill_without_speed() -> None:
    assert windows(StandstillDetector(StaticTestSettings()), rest_ticks(10.0, 0.4), None) == []


def test_a_shaking_engine_is_standstill_when_speed_is_zero() -> None:
    found = windows(StandstillDetector(StaticTestSettings()), rest_ticks(10.0, 0.4), True)
    assert len(found) >= 3


def test_a_smooth_road_is_no_standstill_when_speed_says_so() -> None:
    assert windows(StandstillDetector(StaticTestSettings()), rest_ticks(10.0, 0.01), False) == []


def test_too_few_samples_make_no_window() -> None:
    settings = StaticTestSettings(samples=300, duration=2.0)
    found = windows(StandstillDetector(settings), rest_ticks(8.0, 0.1), None)
    assert [w.samples for w in found] == [300.0], "six seconds at 50 Hz, and no more"


def test_a_rejected_sample_breaks_the_window() -> None:
    rows = rest_ticks(3.5, 0.1)
    rows[15][ACCEL.bad] = 1.0
    assert windows(StandstillDetector(StaticTestSettings()), rows, True) == []


def test_a_slow_drift_is_no_standstill() -> None:
    t = np.arange(500) / 50.0
    f = np.column_stack([0.25 * t, np.zeros(500), np.full(500, G)])
    rows = ticks_from_samples({"accel": Series(t, f)}, 0, 100).tolist()
    assert windows(StandstillDetector(StaticTestSettings()), rows, None) == []


@pytest.mark.parametrize("duration", [0.2, 0.3, 0.4, 0.5])
def test_a_short_window_is_confirmed_while_the_next_ones_run(duration: float) -> None:
    settings = StaticTestSettings(samples=5, duration=duration)
    found = windows(StandstillDetector(settings), rest_ticks(10.0, 0.01), None)
    assert len(found) >= 0.9 * (10.0 - 0.5) / duration - 1.0
