"""Method A as the package has it against the claims, number by number."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucald.config.calibration import MethodASettings, StaticTestSettings
from imucald.core.rotations import (
    levelling_rotation,
    times_columns,
    times_level,
    times_level_columns,
)
from imucald.core.samples import Series
from imucald.motion.column_ticks import ticks_from_samples
from imucald.motion.speed import SpeedInterval
from imucald.motion.straight import angles_agree
from imucald.mount.estimate import MountState
from imucald.mount.method_a.estimator import PublishedEstimator
from imucald.mount.method_a.gate import StraightGate, WanderingOffset
from imucald.mount.method_a.levelling import rotation_about_up
from imucald.mount.method_a.settings import PublishedSettings
from imucald.mount.method_a.static_test import StandstillDetector
from imucald.mount.method_a.target_angle import Manoeuvre, ManoeuvreBook, combined
from mount_settings import published
from publications import method_a as text
from published_drive import Drive, mount_error_deg

G = 9.80665
UP = np.array([0.0, 0.0, G])
RNG = np.random.default_rng(20160610)
MOUNTS = {
    "level": (0, 0, 0),
    "turned": (-60, 0, 0),
    "pitched 85": (0, 85, 0),
    "pitched 90": (20, 90, 0),
    "pitched -90": (-140, -90, 0),
    "on its side": (10, 0, 90),
    "upside down": (0, 0, 180),
    "nearly upside down": (0, 0, 179.9999),
    "leaning": (-60, -30, 100),
}
"""Yaw, pitch, roll [deg]."""
SOME = sorted(MOUNTS) + [f"random {seed}" for seed in range(20)]


def mount(name: str) -> Rotation:
    """R_vehicle_from_sensor."""
    if name in MOUNTS:
        return Rotation.from_euler("ZYX", MOUNTS[name], degrees=True)
    return Rotation.random(random_state=int(name.split()[1]))


def at_rest(name: str) -> np.ndarray:
    return mount(name).inv().apply([0.0, 0.0, G])


# Formulas ---------------------------------------------------------------------------------------


def says_static(a: np.ndarray, threshold: np.ndarray) -> bool:
    """Twenty samples of a tenth of a second."""
    settings = StaticTestSettings(samples=20, duration=0.1, threshold=tuple(threshold.tolist()))
    detector = StandstillDetector(settings)
    series = Series(np.arange(20) / 200.0, a)
    detector.take_tick(ticks_from_samples({"accel": series}, 0, 1).tolist()[0], None)
    return detector.still


def test_claim_7_standstill() -> None:
    for _ in range(200):
        a = RNG.normal(0.0, 0.1, (20, 3)) + UP
        limits = RNG.uniform(0.2, 0.5, 3)
        assert says_static(a, limits) == text.is_static(a, limits)
    apart = np.tile([[0.0, 0.0, 9.75], [0.5, 0.25, 9.5]], (10, 1))
    assert says_static(apart, np.array([0.5, 0.25, 0.25]))  # "less than or equal"
    assert not says_static(apart, np.array([0.5, 0.25, 0.2499]))


@pytest.mark.parametrize("name", SOME)
def test_claims_8_and_9_levelling_by_the_deflection_angles(name: str) -> None:
    J = at_rest(name)
    assert text.vertical(*text.deflection_angles(J)) == pytest.approx(J / G, abs=1e-12)
    assert levelling_rotation(J) == pytest.approx(text.levelling(J), abs=1e-9)
    assert levelling_rotation(J) @ J == pytest.approx([0.0, 0.0, G], abs=1e-9)


@pytest.mark.parametrize("lean", [0.0, 1e-12, 1e-9, 1.5e-6, 1e-4, 0.01, 1.0])
@pytest.mark.parametrize("to", [0.0, 0.7, 2.0, -2.5])
def test_claim_9_levelling_keeps_its_digits_upside_down(lean: float, to: float) -> None:
    """A6: a sensor that hangs upside down, within a hundredth of a degree."""
    side = math.sin(lean)
    J = G * np.array([side * math.cos(to), side * math.sin(to), -math.cos(lean)])
    R = levelling_rotation(J)
    assert pytest.approx(np.eye(3), abs=1e-14) == R @ R.T
    assert np.linalg.det(R) == pytest.approx(1.0, abs=1e-14)
    assert pytest.approx([0.0, 0.0, G], abs=1e-13) == R @ J
    assert pytest.approx(text.levelling(J), abs=1e-9) == R


def test_claim_2_angles_and_their_agreement() -> None:
    for _ in range(500):
        n, window = int(RNG.integers(5, 30)), int(RNG.integers(2, 6))
        spread = float(RNG.uniform(0.1, 1.5))
        middle = RNG.uniform(-4.0, 4.0)
        angles = middle + RNG.normal(0.0, 0.4, n) * RNG.choice([0.3, 1.0], n)
        for first in range(n - window + 1):
            group = angles[first : first + window]
            assert angles_agree(group, spread) == text.agree(list(group), spread)
            assert text.agree(list(group), spread) == text.all_pairs_within(group, spread)


@pytest.mark.parametrize("name", SOME)
def test_claims_1_to_6_the_rotation_and_what_it_does_to_parallel_sensors(name: str) -> None:
    """Straight, variable speed: the acceleration is known in vehicle axes, the mount is sought."""
    R = mount(name)
    J = at_rest(name)
    along = RNG.uniform(0.5, 3.0, 200) * RNG.choice([-1.0, 1.0], 200)
    f = np.column_stack([along, 0.0 * along, np.full(200, G)])
    accel = R.inv().apply(f)
    R_text, lam = text.solve(accel, J, np.ones(200, bool), along > 0.0, 0.25)
    book = ManoeuvreBook(10)
    for part in np.array_split(np.arange(200), 5):
        one = Manoeuvre(0.0, signed=True)
        for i in part.tolist():
            interval = SpeedInterval(0.1 * i, 0.1 * i + 0.1, *accel[i], 10.0, along[i], 0.0, True)
            one.add_interval(interval, tuple(accel[i].tolist()), float(along[i]), 0.0, 1.0)
        book.add_manoeuvre(one)
    level = levelling_rotation(J)
    found = combined(book.pointers(level))
    assert found is not None
    assert math.remainder(found.value - lam, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)
    assert rotation_about_up(found.value) @ level == pytest.approx(R_text, abs=1e-9)
    assert rotation_about_up(found.value) @ level == pytest.approx(R.as_matrix(), abs=1e-6)
    other = RNG.normal(0.0, 1.0, (30, 3))  # gyroscope or magnetometer, axes parallel
    rows = np.tile((rotation_about_up(found.value) @ level).ravel(), (30, 1))
    expected = text.corrected_sensor(other, J, lam)
    assert times_columns(rows, other) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("crown", [0.0, 0.012])
def test_claim_5_alone_turns_a_level_sensor_of_two_axes(crown: float) -> None:
    """Only x and y: L'x, L'y. The crown of a road, which R holds too, is 0.04 mrad of the angle."""
    lean = Rotation.from_euler("x", crown)
    for lam in RNG.uniform(-math.pi, math.pi, 50):
        R = (lean * Rotation.from_euler("z", lam)).as_matrix()
        L = RNG.normal(0.0, 5.0, (20, 2))
        given = np.column_stack([L, np.full(20, np.nan)])
        found = times_level_columns(np.tile(R.ravel(), (20, 1)), given)
        slack = 1e-9 if crown == 0.0 else 4e-5 * np.abs(L).sum(axis=1).max()
        assert found[:, :2] == pytest.approx(text.corrected(L, lam), abs=slack)
        assert np.isnan(found[:, 2]).all()
        one_by_one = [times_level(tuple(R.ravel().tolist()), v) for v in given.tolist()]
        assert np.array_equal(found, np.array(one_by_one), equal_nan=True)


# Options, each alone ----------------------------------------------------------------------------

NAMES = ("level", "upside down", "pitched 85", "leaning")
PLACES = {
    "steering": (("gyro", "yaw_rate"), {"straight": {"recognise_by": ("steering",)}}),
    "yaw rate of the vehicle": (
        ("gyro", "steering"),
        {"straight": {"recognise_by": ("yaw_rate",)}},
    ),
    "gyroscope": (("yaw_rate", "steering"), {"straight": {"recognise_by": ("yaw_rate",)}}),
    "agreement": (
        ("gyro", "yaw_rate", "steering"),
        {"straight": {"recognise_by": ("consistency",)}},
    ),
    "sign by speed": (("brake",), {"target": {"sign_from": ("speed",)}}),
    "sign by brake": (("speed",), {"target": {"sign_from": ("brake",)}}),
    "sign by turns": (("speed", "brake"), {"target": {"sign_from": ("turn",)}}),
    "sign by first motion": (("speed", "brake"), {"target": {"sign_from": ("first_motion",)}}),
    "last stop decides": ((), {"static": {"average_stops": False}}),
    "offset stays": ((), {"target": {"remove_offset_after": 0.0}}),
    "v r stays": ((), {"target": {"subtract_lateral": False}}),
}
BOUND_DEG = {"last stop decides": 4.0, "sign by first motion": 2.0, "agreement": 2.0}
"""A single stop has the slope of its place, 1.3 deg per axis; agreement takes slow turns along."""


def run(drive: Drive, missing: tuple[str, ...], settings: PublishedSettings) -> PublishedEstimator:
    estimator = PublishedEstimator(settings)
    for row in drive.ticks(*missing):
        estimator.step(row)
    return estimator


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("option", sorted(PLACES))
def test_each_option_is_enough_alone(option: str, name: str) -> None:
    missing, changes = PLACES[option]
    drive = Drive(minutes=12, seed=7, mount=mount(name), imu_rate=50.0)
    estimate = run(drive, missing, published(**changes)).estimate()
    assert estimate.state >= MountState.USABLE, estimate.waiting_for
    assert estimate.R_vehicle_from_sensor is not None
    off = float(np.linalg.norm(mount_error_deg(estimate.R_vehicle_from_sensor, mount(name))))
    assert off < BOUND_DEG.get(option, 1.5)


ALONE = ("speed", "gyro", "yaw_rate", "steering", "brake")


def random_mount_error(seed: int, settings: PublishedSettings) -> tuple[MountState, float, float]:
    """State, error of the yaw, stated deviation [deg]: the accelerometer and nothing else."""
    turned = Rotation.random(random_state=seed)
    estimate = run(Drive(minutes=12, seed=seed, mount=turned), ALONE, settings).estimate()
    assert estimate.R_vehicle_from_sensor is not None
    assert estimate.std is not None
    yaw = float(mount_error_deg(estimate.R_vehicle_from_sensor, turned)[2])
    return estimate.state, abs(yaw), math.degrees(estimate.std[2])


@pytest.mark.slow
def test_a4_claim_2_alone_the_accelerometer_and_nothing_else() -> None:
    """Four drives with steady turns, which agree as well as straight motion does."""
    found = [random_mount_error(seed, published(use_speed=False)) for seed in (4, 5, 6, 7)]
    assert all(yaw < 3.0 * std for _, yaw, std in found)
    usable = [yaw for state, yaw, _ in found if state == MountState.USABLE]
    assert len(usable) >= 3
    assert max(usable) < 1.5


def together(recognise_by: object, yaw_rate: float, steering_deg: float) -> bool:
    """What is said of 2 s of driving with this yaw rate and wheel angle."""
    settings = published(straight={"recognise_by": recognise_by, "lateral_limit": 0.0})
    gate = StraightGate(settings, WanderingOffset(1.0))
    interval = SpeedInterval(0.0, 0.2, 1.0, 0.0, G, 10.0, 1.0, yaw_rate, True)
    return gate.is_straight(interval, math.radians(steering_deg), math.nan, np.eye(3))


@pytest.mark.parametrize(
    ("recognise_by", "yaw_rate", "steering_deg", "expected"),
    [
        ("all", 0.0, 0.0, True),
        ("all", 0.0, 115.0, False),
        ("all", 0.05, 0.0, False),
        ("all", 0.0, math.nan, False),  # one of them is not there
        (("yaw_rate", "steering"), 0.0, 115.0, True),  # by preference
        (("steering", "yaw_rate"), 0.05, 0.0, True),
        ((("steering", "yaw_rate"), "yaw_rate"), 0.0, math.nan, True),  # the group's signal is gone
        ((("steering", "yaw_rate"), "yaw_rate"), 0.05, math.nan, False),
    ],
)
def test_a3_claim_4_steering_and_yaw_rate_together(
    recognise_by: object, yaw_rate: float, steering_deg: float, expected: bool
) -> None:
    assert together(recognise_by, yaw_rate, steering_deg) is expected
    if not math.isnan(steering_deg) and recognise_by == "all":
        claim = text.straight(
            np.array([math.radians(steering_deg)]), np.array([yaw_rate]), math.radians(10.0),
            math.radians(1.0), need="all",
        )  # fmt: skip
        assert bool(claim[0]) is expected


def test_a3_both_together_find_the_mount() -> None:
    drive = Drive(minutes=10, seed=7, mount=mount("leaning"), imu_rate=50.0)
    estimate = run(drive, ("gyro",), published(straight={"recognise_by": "all"})).estimate()
    assert estimate.state >= MountState.USABLE
    assert estimate.R_vehicle_from_sensor is not None
    error = mount_error_deg(estimate.R_vehicle_from_sensor, mount("leaning"))
    assert float(np.linalg.norm(error)) < 1.5


def test_a2_to_the_letter_leaves_out_all_that_was_added() -> None:
    """The last stop decides: the tilt is that stop's, slope and all."""
    letter = MethodASettings(to_the_letter=True)
    drive = Drive(minutes=10, seed=7, mount=mount("leaning"), imu_rate=50.0, turns=False)
    estimator = run(drive, ("steering", "brake"), published({"method_a": letter}))
    plain = run(drive, ("steering", "brake"), published())
    applied = estimator._settings
    assert not applied.calibration.static.average_stops
    assert not applied.calibration.target_angle.subtract_lateral
    assert (applied.wander_speed, applied.settle) == (0.0, 0.0)
    R, other = (e.estimate().R_vehicle_from_sensor for e in (estimator, plain))
    assert R is not None
    assert other is not None
    error = float(np.linalg.norm(mount_error_deg(R, mount("leaning"))))
    assert error < 4.0
    assert error > float(np.linalg.norm(mount_error_deg(other, mount("leaning"))))


def test_claims_1_to_5_without_6_a_level_sensor_is_not_levelled() -> None:
    turned = Rotation.from_euler("z", -70.0, degrees=True)
    drive = Drive(minutes=8, seed=7, mount=turned, imu_rate=50.0, stops=False)
    flat = published({"method_a": MethodASettings(level=False)})
    estimate = run(drive, ("steering", "brake"), flat).estimate()
    R = estimate.R_vehicle_from_sensor
    assert estimate.state >= MountState.USABLE, estimate.waiting_for
    assert R is not None
    assert R[2] == pytest.approx([0.0, 0.0, 1.0], abs=1e-12)
    assert abs(mount_error_deg(R, turned)[2]) < 1.0
