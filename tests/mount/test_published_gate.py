"""The gate on straight motion by single intervals, and what is done about v r that passes it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucald.motion.speed import SpeedInterval
from imucald.mount.estimate import MountState
from imucald.mount.method_a.estimator import PublishedEstimator
from imucald.mount.method_a.gate import StraightGate, WanderingOffset
from imucald.mount.method_a.settings import PublishedSettings
from mount_settings import published
from published_drive import Drive, mount_error_deg

NAN = math.nan
DEG = math.radians(1.0)


def interval(speed: float = NAN, yaw_rate: float = NAN) -> SpeedInterval:
    return SpeedInterval(0.0, 0.2, 0.0, 0.0, 9.81, speed, NAN, yaw_rate, True)


def straight(
    settings: PublishedSettings,
    motion: SpeedInterval,
    steering: float = NAN,
    own_lateral: float = NAN,
) -> bool:
    gate = StraightGate(settings, WanderingOffset(1.0))
    return gate.is_straight(motion, steering, own_lateral, np.eye(3))


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_steering_angle_decides_where_it_is_preferred(side: float) -> None:
    settings = published(straight={"recognise_by": ("steering",), "steering_limit_deg": 10.0})
    assert straight(settings, interval(), steering=side * 9.9 * DEG)
    assert not straight(settings, interval(), steering=side * 10.1 * DEG)
    assert not straight(settings, interval()), "nothing recognises it"


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_yaw_rate_has_a_narrower_limit_where_no_gate_on_v_r_stands_beside_it(
    side: float,
) -> None:
    settings = published(
        straight={
            "recognise_by": ("yaw_rate",),
            "yaw_rate_limit_deg_s": 2.0,
            "yaw_rate_limit_without_speed_deg_s": 1.0,
        }
    )
    assert straight(settings, interval(10.0, side * 1.9 * DEG))
    assert not straight(settings, interval(10.0, side * 2.1 * DEG))
    assert straight(settings, interval(NAN, side * 0.9 * DEG))
    assert not straight(settings, interval(NAN, side * 1.1 * DEG))


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("recogniser", ["steering", "yaw_rate", "consistency"])
def test_lateral_acceleration_must_be_small_whatever_recognises(
    recogniser: str, side: float
) -> None:
    settings = published(straight={"recognise_by": (recogniser,), "lateral_limit": 0.6})
    fast = interval(30.0, side * 1.3 * DEG)  # 0.68 m/s^2
    slow = interval(25.0, side * 1.3 * DEG)  # 0.57 m/s^2
    assert not straight(settings, fast, steering=0.0)
    if recogniser != "consistency":  # which asks for a window first
        assert straight(settings, slow, steering=0.0)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_vehicles_own_lateral_acceleration_stands_in_where_v_r_is_not_known(
    side: float,
) -> None:
    settings = published(straight={"recognise_by": ("steering",), "lateral_limit": 0.6})
    assert straight(settings, interval(), steering=0.0, own_lateral=side * 0.5)
    assert not straight(settings, interval(), steering=0.0, own_lateral=side * 0.7)
    assert straight(settings, interval(20.0, 0.0), steering=0.0, own_lateral=side * 0.7), "v r is 0"
    without = published(straight={"recognise_by": ("steering",), "lateral_limit": 0.0})
    assert straight(without, interval(), steering=0.0, own_lateral=side * 5.0)


@dataclass
class Bent(Drive):
    """Bends to the left while the vehicle accelerates, to the right while it brakes: v r goes with
    dv/dt and does not average out."""

    def motion(self) -> tuple[np.ndarray, ...]:
        t, speed, accel, _ = super().motion()
        along = np.clip(accel, -1.0, 1.0)
        return t, speed, accel, np.where(speed > 1.0, 1.8 * DEG * along, 0.0)


def errors(subtract: bool) -> Iterator[float]:
    mount = Rotation.from_euler("ZYX", [1.1, 0.2, -0.1])
    settings = published(target={"subtract_lateral": subtract})
    for seed in range(3):
        drive = Bent(minutes=8, seed=seed, mount=mount, turns=False, slope_deg=0.3)
        estimator = PublishedEstimator(settings)
        for row in drive.ticks("brake", "steering", "gyro"):
            estimator.step(row)
        found = estimator.estimate().R_vehicle_from_sensor
        assert found is not None
        yield abs(float(mount_error_deg(found, mount)[2]))


@pytest.mark.slow
def test_v_r_that_passes_the_gate_is_subtracted() -> None:
    assert max(errors(subtract=True)) < 1.5
    assert min(errors(subtract=False)) > 3.0


@pytest.mark.slow
def test_the_brake_switch_alone_shows_the_sign() -> None:
    mount = Rotation.from_euler("ZYX", [1.1, 0.2, -0.1])
    drive = Drive(minutes=8, seed=4, mount=mount, turns=False)
    found = []
    for leave_out in (("speed", "gyro", "yaw_rate", "steering"), ("speed", "gyro", "brake")):
        estimator = PublishedEstimator(published(target={"sign_from": ("brake",)}))
        for row in drive.ticks(*leave_out):
            estimator.step(row)
        found.append(estimator.estimate())
    with_brake, without = found
    assert with_brake.state >= MountState.USABLE
    assert with_brake.R_vehicle_from_sensor is not None
    assert abs(mount_error_deg(with_brake.R_vehicle_from_sensor, mount)[2]) < 3.0
    assert without.state < MountState.USABLE
