from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imucald.core.samples import Series
from imucald.motion.column_ticks import ticks_from_samples
from imucald.motion.straight import (
    MAX_HOLD_TICKS,
    YawRateSource,
    angles_agree,
    yaw_rate_from_steering,
    yaw_rate_with_understeer,
)

DEG = math.radians(1.0)


@pytest.mark.slow
@given(
    st.lists(st.floats(0.0, 0.3), min_size=1, max_size=20),
    st.floats(-10.0, 10.0),
    st.integers(-3, 3),
)
def test_angles_agree_wherever_on_the_circle_the_arc_lies(
    spreads: list[float], centre: float, turns: int
) -> None:
    angles = [centre + s + 2.0 * math.pi * turns for s in spreads]
    width = max(spreads) - min(spreads)
    assert angles_agree(angles, width + 1e-6)
    if width > 1e-3:
        assert not angles_agree(angles, width - 1e-4)


def test_no_angle_agrees_with_nothing() -> None:
    assert not angles_agree([], 1.0)


def test_yaw_rate_from_steering_is_the_kinematic_single_track() -> None:
    # A road wheel at 10 deg and a wheelbase of 2.5 m: circle of radius 2.5 / tan(10 deg).
    radius = 2.5 / math.tan(10 * DEG)
    assert yaw_rate_from_steering(5.0, 150 * DEG, 15.0, 2.5) == pytest.approx(5.0 / radius)


def rows(**series: Series) -> list[list[float]]:
    return ticks_from_samples(series, 0, 40).tolist()


T = np.arange(400) / 100.0


def last(source: YawRateSource, ticks: list[list[float]], at_rest: int = 0, **kw: object) -> float:
    up, speed = kw.get("up", (0.0, 0.0, 1.0)), kw.get("speed", math.nan)
    rate = math.nan
    for i, row in enumerate(ticks):
        rate = source.take_tick(row, up, speed, i < at_rest)  # type: ignore[arg-type]
    return rate


def test_the_gyro_is_projected_on_gravity() -> None:
    up = np.array([1.0, -2.0, 2.0]) / 3.0
    gyro = Series(T, np.tile(0.4 * up, (len(T), 1)))
    source = YawRateSource(15.0, 2.7)
    assert last(source, rows(gyro=gyro), up=tuple(up)) == pytest.approx(0.4)
    assert source.source == "gyro"
    assert math.isnan(last(YawRateSource(15.0, 2.7), rows(gyro=gyro), up=None))


def test_the_offset_at_rest_is_taken_off() -> None:
    rate = np.where(T < 2.0, 0.01, 0.11)
    gyro = np.column_stack([np.zeros(len(T)), np.zeros(len(T)), rate])
    for series in ({"yaw_rate": Series(T, rate)}, {"gyro": Series(T, gyro)}):
        assert last(YawRateSource(15.0, 2.7), rows(**series), at_rest=20) == pytest.approx(0.1)


def test_a_turntable_is_no_offset() -> None:
    source = YawRateSource(15.0, 2.7)
    assert last(
        source, rows(yaw_rate=Series(T, np.full(len(T), 0.5))), at_rest=40
    ) == pytest.approx(0.5)


def test_sources_by_preference_and_steering_only_where_allowed() -> None:
    steering = Series(T, np.full(len(T), 0.15))
    rate = Series(T, np.full(len(T), 0.3))
    assert last(
        YawRateSource(15.0, 2.7), rows(steering=steering, yaw_rate=rate), speed=5.0
    ) == pytest.approx(0.3)
    source = YawRateSource(15.0, 2.7)
    expected = 5.0 * math.tan(0.01) / 2.7
    assert last(source, rows(steering=steering), speed=5.0) == pytest.approx(expected)
    assert source.source == "steering"
    assert math.isnan(last(YawRateSource(15.0, 2.7), rows(steering=steering)))
    without = YawRateSource(15.0, 2.7, use_steering=False)
    assert math.isnan(last(without, rows(steering=steering), speed=5.0))


def test_a_silent_signal_is_held_for_a_second_and_no_longer() -> None:
    early = T < 1.0
    ticks = rows(yaw_rate=Series(T[early], np.full(int(early.sum()), 0.2)))
    held = ticks[: 10 + MAX_HOLD_TICKS]
    assert last(YawRateSource(15.0, 2.7), held) == pytest.approx(0.2)
    assert math.isnan(last(YawRateSource(15.0, 2.7), ticks))


def test_with_understeer_a_steady_bend_takes_the_wheel_that_tyres_need() -> None:
    """Steady state of the single-track model: delta / n = L r / v + K v r."""
    v, r, n, L, K = np.array([5.0, 15.0, 30.0]), np.array([0.2, -0.1, 0.05]), 15.0, 2.7, 0.0025
    wheel = n * (L * r / v + K * v * r)
    assert yaw_rate_with_understeer(v, wheel, n, L, K) == pytest.approx(r)


def test_without_understeer_and_for_small_angles_both_forms_agree() -> None:
    v, wheel = np.array([10.0]), np.array([0.1])
    small = yaw_rate_with_understeer(v, wheel, 15.0, 2.7, 0.0)
    assert small == pytest.approx(yaw_rate_from_steering(10.0, 0.1, 15.0, 2.7), rel=1e-4)
