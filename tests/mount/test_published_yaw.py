"""The published solver on sample arrays, against simulated truth."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from imucald.core.errors import EstimateError
from imucald.mount.method_a.solver import (
    combined_angle,
    combined_axis,
    correction_rotation,
    solve_published,
    straight_samples,
    target_angles,
    with_sign,
)
from mount_settings import published
from published_drive import mount_error_deg

G = 9.80665
ANGLE = st.floats(-math.pi, math.pi)
PLAIN = published(static={"samples": 50})


def recording(mount: Rotation) -> dict[str, np.ndarray]:
    """50 Hz: rest, acceleration, a braking bend, braking, acceleration; vehicle level, no noise."""
    a = np.repeat([0.0, 1.5, -2.0, -1.2, 0.9], [100, 200, 50, 150, 100])
    yaw_rate = np.repeat([0.0, 0.0, 0.4, 0.0, 0.0], [100, 200, 50, 150, 100])
    speed = np.cumsum(a) / 50.0
    f = np.column_stack([a, speed * yaw_rate, np.full(len(a), G)])
    steering = 15.0 * np.arctan2(2.7 * yaw_rate, np.maximum(speed, 1.0))
    return {
        "accel": mount.inv().apply(f),
        "vehicle": f,
        "yaw_rate": yaw_rate,
        "steering": steering,
        "accelerating": a > 0.0,
    }


@settings(deadline=None, max_examples=60)
@given(ANGLE, st.floats(-1.5, 1.5), ANGLE)
def test_any_mount_is_found_exactly_and_the_correction_restores_vehicle_axes(
    yaw: float, pitch: float, roll: float
) -> None:
    mount = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    drive = recording(mount)
    for extra in ({"yaw_rate": drive["yaw_rate"]}, {"steering": drive["steering"]}):
        found = solve_published(drive["accel"], PLAIN, drive["accelerating"], **extra)
        assert np.abs(mount_error_deg(found.R_vehicle_from_sensor, mount)).max() < 1e-6
        restored = drive["accel"] @ found.R_vehicle_from_sensor.T
        assert restored == pytest.approx(drive["vehicle"], abs=1e-6)
        assert found.resultant == pytest.approx(1.0)
        assert found.used == 450, "the bend is left out"


def test_window_consistency_alone_leaves_the_bend_out() -> None:
    mount = Rotation.from_euler("ZYX", [2.0, 0.3, -0.4])
    drive = recording(mount)
    narrow = published(
        static={"samples": 50}, straight={"consistency_window": 20, "consistency_range_deg": 3.0}
    )
    found = solve_published(drive["accel"], narrow, drive["accelerating"])
    assert abs(mount_error_deg(found.R_vehicle_from_sensor, mount)[2]) < 0.3
    # A spread as wide as the circle lets the bend in, and it shows: the gate is what keeps it out.
    open_gate = published(
        static={"samples": 50}, straight={"consistency_window": 20, "consistency_range_deg": 400.0}
    )
    worse = solve_published(drive["accel"], open_gate, drive["accelerating"])
    assert abs(mount_error_deg(worse.R_vehicle_from_sensor, mount)[2]) > 2.0


def test_the_correction_is_the_published_formula_after_the_tilt() -> None:
    lam = 0.7
    R = correction_rotation([0.0, 0.0, G], lam)
    x, y, z = 1.2, -0.4, 9.0
    expected = [x * math.cos(lam) - y * math.sin(lam), x * math.sin(lam) + y * math.cos(lam), z]
    assert pytest.approx(expected) == R @ np.array([x, y, z])


def test_target_angle_of_a_level_sensor_is_the_yaw_of_its_mount() -> None:
    for yaw in np.radians([-170, -30, 0, 45, 120]):
        levelled = Rotation.from_euler("Z", yaw).inv().apply([[1.5, 0.0, G]])
        assert target_angles(levelled)[0] == pytest.approx(yaw)


def test_braking_is_turned_round() -> None:
    got = with_sign([0.1, 0.1 - math.pi], [True, False])
    assert np.exp(1j * got) == pytest.approx(np.exp(1j * np.array([0.1, 0.1])))


def test_angles_combine_across_the_seam_by_weight() -> None:
    angle, resultant = combined_angle(np.radians([179.0, -179.0]), [1.0, 1.0])
    assert abs(math.degrees(angle)) == pytest.approx(180.0)
    assert resultant == pytest.approx(math.cos(math.radians(1.0)))
    angle, _ = combined_angle(np.radians([0.0, 2.0]), [3.0, 1.0])
    assert math.degrees(angle) == pytest.approx(0.5, abs=1e-3)
    with pytest.raises(EstimateError):
        combined_angle([0.0], [0.0])


def test_an_axis_ignores_the_sign() -> None:
    angle, resultant = combined_axis(np.radians([20.0, 200.0, 20.0]), [1.0, 1.0, 1.0])
    assert math.degrees(angle) == pytest.approx(20.0)
    assert resultant == pytest.approx(1.0)


def test_the_preferred_recogniser_with_a_signal_decides() -> None:
    angles = np.zeros(20)
    turning, straight = np.full(20, 1.0), np.zeros(20)
    both = published(straight={"recognise_by": ("steering", "yaw_rate")})
    assert straight_samples(angles, both, straight, turning).all()
    assert not straight_samples(angles, both, turning, straight).any()
    assert straight_samples(angles, both, None, straight).all()
    assert straight_samples(angles, PLAIN).all(), "equal angles agree"
    with pytest.raises(EstimateError):
        straight_samples(angles, both)


def test_a_recording_that_lacks_something_says_what() -> None:
    drive = recording(Rotation.identity())
    moving = drive["accel"][110:] + np.random.default_rng(0).normal(size=(490, 3))
    with pytest.raises(EstimateError, match="standstill"):
        solve_published(
            moving, PLAIN, drive["accelerating"][110:], yaw_rate=drive["yaw_rate"][110:]
        )
    with pytest.raises(EstimateError, match="variable-speed"):
        solve_published(
            drive["accel"][:100], PLAIN, drive["accelerating"][:100], yaw_rate=np.zeros(100)
        )
