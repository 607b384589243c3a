"""The published solver online, on ticks of simulated drives with known truth."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucald.config.calibration import MethodASettings
from imucald.core.rotations import vector_from_rotation
from imucald.motion.ticks import ACCEL, BRAKE, REVERSE, SPEED, T
from imucald.mount.estimate import Missing, MountEstimate, MountState
from imucald.mount.method_a.estimator import PublishedEstimator
from imucald.mount.method_a.settings import PublishedSettings
from imucald.mount.method_a.target_angle import combined
from mount_settings import published
from published_drive import Drive, mount_error_deg

MOUNT = Rotation.from_euler("ZYX", [2.2, 0.25, -0.3])
Rows = Sequence[Sequence[float]]


AS_PUBLISHED = published(
    static={"average_stops": False},
    straight={"lateral_limit": 0.0},
    target={"subtract_lateral": False, "remove_offset_after": 0.0},
    wander_speed=0.0,
)
"""Without what goes beyond the publication."""


def run(rows: Rows, settings: PublishedSettings | None = None) -> MountEstimate:
    estimator = PublishedEstimator(settings)
    for row in rows:
        estimator.step(row)
    assert (estimator.correction is None) == (estimator.state < MountState.USABLE)
    return estimator.estimate()


def error_deg(estimate: MountEstimate, mount: Rotation = MOUNT) -> np.ndarray:
    assert estimate.R_vehicle_from_sensor is not None
    return mount_error_deg(estimate.R_vehicle_from_sensor, mount)


@pytest.fixture(scope="module")
def rows() -> list[list[float]]:
    return Drive(minutes=8, seed=1, mount=MOUNT).ticks("brake", "steering", "yaw_rate")


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_any_mount_converges_within_its_own_interval(seed: int) -> None:
    mount = Rotation.random(random_state=seed)
    drive = Drive(minutes=8, seed=seed, mount=mount, speed_step=0.0)
    estimate = run(drive.ticks("steering", "brake"))
    error, std = error_deg(estimate, mount), np.degrees(estimate.std or ())
    assert estimate.state >= MountState.USABLE
    assert abs(error[2]) < 1.0
    assert np.all(np.abs(error) < 3.0 * std)
    assert std.max() < 2.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("missing", "limit_deg"),
    [
        (("gyro", "steering", "brake"), 1.0),  # the vehicle's yaw rate
        (("yaw_rate", "steering", "brake"), 1.0),  # the levelled gyro
        (("yaw_rate", "gyro", "brake"), 1.5),  # the steering angle
        (("yaw_rate", "gyro", "steering", "brake"), 3.0),  # window consistency
        (("speed", "steering", "brake"), 2.0),  # no speed: axis, sign from turns and first motion
    ],
)
def test_each_recogniser_and_each_sign_source_is_enough(
    missing: tuple[str, ...], limit_deg: float
) -> None:
    estimate = run(Drive(minutes=10, seed=4, mount=MOUNT).ticks(*missing))
    assert estimate.state >= MountState.USABLE, estimate.waiting_for
    assert abs(error_deg(estimate)[2]) < limit_deg


@pytest.mark.slow
def test_an_accelerometer_and_a_brake_switch_alone_are_enough_on_a_straight_road() -> None:
    drive = Drive(minutes=10, seed=4, mount=MOUNT, turns=False)
    estimate = run(drive.ticks("speed", "gyro", "yaw_rate", "steering"))
    assert estimate.state >= MountState.USABLE, estimate.waiting_for
    assert abs(error_deg(estimate)[2]) < 3.0


@pytest.mark.slow
def test_an_accelerometer_alone_among_turns_does_not_claim_what_it_lacks() -> None:
    drive = Drive(minutes=10, seed=4, mount=MOUNT)
    estimate = run(drive.ticks("speed", "gyro", "yaw_rate", "steering"))
    assert abs(error_deg(estimate)[2]) < 3.0 * math.degrees((estimate.std or (0, 0, 0))[2])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("recogniser", "left_in"), [("steering", "steering"), ("yaw_rate", "gyro"), ("consistency", "")]
)
def test_a_recogniser_that_is_configured_alone_decides_alone(recogniser: str, left_in: str) -> None:
    settings = published(straight={"recognise_by": (recogniser,)})
    drive = Drive(minutes=8, seed=2, mount=MOUNT)
    out = {"gyro", "yaw_rate", "steering", "brake"} - {left_in}
    assert abs(error_deg(run(drive.ticks(*out), settings))[2]) < 3.0
    if left_in:
        silent = run(drive.ticks("gyro", "yaw_rate", "steering", "brake"), settings)
        assert silent.details["manoeuvres"] == 0


@pytest.mark.slow
def test_circles_never_give_a_yaw() -> None:
    drive = Drive(minutes=8, seed=1, mount=MOUNT, circles=True)
    for missing in (
        (),
        ("speed",),
        ("gyro", "yaw_rate", "steering"),
        ("speed", "gyro", "yaw_rate"),
    ):
        estimator = PublishedEstimator()
        for row in drive.ticks(*missing):
            estimator.step(row)
            assert estimator.state < MountState.USABLE, missing
            assert estimator.correction is None
        assert "yaw" in estimator.estimate().waiting_for


@pytest.mark.slow
def test_an_unresolved_sign_is_never_usable_and_is_stated() -> None:
    estimate = run(
        Drive(minutes=8, seed=4, mount=MOUNT).ticks("speed", "brake"),
        published(target={"sign_from": ("brake",)}),
    )
    assert estimate.state == MountState.LEVELLED
    assert estimate.missing["yaw"] == Missing.DIRECTION_OF_TRAVEL
    assert estimate.std is not None
    assert estimate.std[2] > 1.5, "half a turn is open"


@pytest.mark.slow
def test_coarse_slow_and_late_speed_is_enough() -> None:
    late = Drive(
        minutes=8, seed=5, mount=MOUNT, speed_rate=1.0, speed_step=1 / 3.6, speed_delay=0.4
    )
    ticks = late.ticks("yaw_rate", "steering", "brake")
    for delay in (0.0, 0.4):
        estimate = run(ticks, published({"speed_delay": delay}))
        assert estimate.state >= MountState.USABLE
        assert abs(error_deg(estimate)[2]) < 1.5


@pytest.mark.slow
def test_a_planar_accelerometer_is_level_and_needs_no_stop() -> None:
    mount = Rotation.from_euler("Z", 0.8)
    ticks = Drive(minutes=8, seed=3, mount=mount).ticks("gyro", "steering", "brake")
    for row in ticks:
        for i in range(ACCEL.z, ACCEL.z + 12, 3):
            row[i] = math.nan
    estimate = run(ticks, PublishedSettings(planar=True))
    assert estimate.state >= MountState.USABLE
    roll, pitch, yaw = estimate.angles or (9.0, 9.0, 9.0)
    assert (roll, pitch) == pytest.approx((0.0, 0.0), abs=1e-12)
    assert math.degrees(yaw - 0.8) == pytest.approx(0.0, abs=1.0)
    first = PublishedEstimator(PublishedSettings(planar=True))
    assert first.state == MountState.LEVELLED


@pytest.mark.slow
def test_reverse_gear_turns_the_answer_round(rows: Rows) -> None:
    # The same path driven backwards throughout: the vehicle points the other way.
    backwards = [list(row) for row in rows]
    for row in backwards:
        row[REVERSE] = 1.0
    estimate = run(backwards)
    assert np.abs(error_deg(estimate, Rotation.from_euler("Z", math.pi) * MOUNT))[2] < 1.0


@pytest.mark.slow
def test_the_level_of_a_drive_without_a_stop_comes_late_and_uncertain() -> None:
    ticks = Drive(minutes=8, seed=6, mount=MOUNT, stops=False).ticks("brake", "steering")
    moving = ticks[200:]
    estimator = PublishedEstimator()
    levelled_at = None
    for row in moving:
        estimator.step(row)
        if levelled_at is None and estimator.state >= MountState.LEVELLED:
            levelled_at = row[T] - moving[0][T]
    assert levelled_at is not None
    assert levelled_at >= 119.0
    estimate = estimator.estimate()
    assert estimate.details["stops"] == 0
    error, std = error_deg(estimate), np.degrees(estimate.std or ())
    assert np.all(np.abs(error) < 3.0 * std)
    stopped = run(ticks)
    assert std[1] > np.degrees((stopped.std or ())[1]) - 1.0


@pytest.mark.slow
def test_the_correction_is_smooth_and_the_same_every_time(rows: Rows) -> None:
    a, b = PublishedEstimator(), PublishedEstimator()
    before = None
    limit = math.radians(0.5) * 0.1 + 1e-9
    for row in rows:
        a.step(row)
        b.step(row)
        assert a.correction == b.correction
        if before is not None and a.correction is not None:
            R, R0 = (c.matrix() for c in (a.correction, before))
            assert float(np.linalg.norm(vector_from_rotation(R @ R0.T))) <= limit
        assert before is None or a.correction is not None, "what was usable is not taken away"
        before = a.correction
    assert before is not None


@pytest.mark.slow
def test_asking_for_the_estimate_changes_nothing(rows: Rows) -> None:
    a, b = PublishedEstimator(), PublishedEstimator()
    for row in rows:
        a.step(row)
        b.step(row)
        b.estimate()
    assert a.correction == b.correction


@pytest.mark.slow
def test_nothing_is_learnt_while_samples_are_rejected(rows: Rows) -> None:
    estimator = PublishedEstimator()
    for row in rows[:3000]:
        estimator.step(row)
    before = estimator.estimate()
    for row in rows[3000:]:
        damaged = list(row)
        damaged[ACCEL.bad] = 3.0
        damaged[ACCEL.x] += 4.0
        estimator.step(damaged)
    after = estimator.estimate()
    assert np.array_equal(before.R_vehicle_from_sensor, after.R_vehicle_from_sensor)
    assert np.array_equal(before.covariance, after.covariance)


@pytest.mark.slow
def test_scattered_bad_samples_and_implausible_forces_do_no_harm(rows: Rows) -> None:
    rng = np.random.default_rng(0)
    damaged = []
    for row in rows:
        new = list(row)
        kind = rng.random()
        if kind < 0.02:
            new[ACCEL.bad] = 1.0
            new[ACCEL.x : ACCEL.x + 3] = rng.normal(0, 30, 3).tolist()
        elif kind < 0.03:
            new[ACCEL.x : ACCEL.x + 3] = [rng.choice([1e6, math.inf, math.nan, 0.0])] * 3
        elif kind < 0.05:
            new[SPEED.bad] = 1.0
            new[SPEED.mean] = 60.0
        damaged.append(new)
    assert abs(error_deg(run(damaged))[2]) < 1.0


@pytest.mark.slow
def test_a_stuck_accelerometer_teaches_nothing(rows: Rows) -> None:
    stuck = [list(row) for row in rows]
    for row in stuck[100:]:
        row[ACCEL.x : ACCEL.x + 12] = stuck[100][ACCEL.x : ACCEL.x + 6] + stuck[100][2:5] * 2
    estimate = run(stuck)
    assert estimate.state < MountState.USABLE


def test_saturated_samples_are_left_out(rows: Rows) -> None:
    settings = published({"accelerometer_range": 8.0})  # gravity alone is close to full scale
    assert run(rows, settings).details["manoeuvres"] == 0


@pytest.mark.slow
def test_a_gap_in_time_is_survived(rows: Rows) -> None:
    estimator = PublishedEstimator()
    for k, row in enumerate(rows):
        if k % 400 == 0:
            estimator.gap()
        shifted = list(row)
        shifted[T] += 1000.0 * (k // 400)
        estimator.step(shifted)
    assert estimator.state >= MountState.USABLE
    assert abs(error_deg(estimator.estimate())[2]) < 1.0


@pytest.mark.slow
def test_speed_that_comes_and_goes_is_survived(rows: Rows) -> None:
    patchy = [list(row) for row in rows]
    for k, row in enumerate(patchy):
        if (k // 150) % 2:
            row[SPEED.n], row[SPEED.mean] = 0.0, math.nan
    estimate = run(patchy)
    assert abs(error_deg(estimate)[2]) < 1.5


@pytest.mark.slow
def test_the_brake_switch_may_stay_unknown(rows: Rows) -> None:
    assert all(math.isnan(row[BRAKE]) for row in rows)
    assert run(rows).state >= MountState.USABLE


@pytest.mark.slow
def test_as_published_works_and_the_additions_make_it_better() -> None:
    plain, full = [], []
    for seed in range(4):
        ticks = Drive(minutes=8, seed=seed, mount=MOUNT).ticks("yaw_rate", "steering", "brake")
        plain.append(error_deg(run(ticks, AS_PUBLISHED)))
        full.append(error_deg(run(ticks)))
    rms_plain, rms_full = (np.sqrt(np.mean(np.square(e), axis=0)) for e in (plain, full))
    assert rms_plain[2] < 3.0
    assert rms_full[2] < rms_plain[2]
    assert np.hypot(*rms_full[:2]) < np.hypot(*rms_plain[:2])


def test_without_a_reverse_signal_its_own_least_speed_rules(rows: Rows) -> None:
    slow = {"min_speed_without_reverse": 1.0}
    counts = [run(rows, published(straight=s)).details["manoeuvres"] for s in (
        {"min_speed_without_reverse": 9.0}, {}, slow, slow | {"min_speed": 9.0})]  # fmt: skip
    assert counts[0] < counts[1] <= counts[2] == counts[3] > 0
    letter = {"method_a": MethodASettings(to_the_letter=True)}
    counts = [
        run(rows, published(letter, straight={"min_speed": v})).details["manoeuvres"]
        for v in (1.0, 9.0)
    ]
    assert counts[1] < counts[0]


def test_the_mean_of_each_angle_is_a_key() -> None:
    rows = Drive(minutes=4, seed=2, mount=MOUNT).ticks("gyro", "yaw_rate", "steering", "brake")
    found = [
        run(rows, published(straight={"consistency_mean": s})).R_vehicle_from_sensor
        for s in (0.1, 1.0)
    ]
    assert not np.array_equal(found[0], found[1])


def test_to_the_letter_nothing_levels_but_a_stop_and_no_crown_leans(rows: Rows) -> None:
    letter = {"method_a": MethodASettings(to_the_letter=True)}
    moving = Drive(minutes=6, seed=6, mount=MOUNT, stops=False).ticks("brake", "steering")[200:]
    estimate = run(moving, published(letter))
    assert estimate.state == MountState.WAITING
    assert estimate.missing["roll"] == Missing.STANDSTILL
    plain = run(rows, published(letter))
    leaning = run(rows, published(letter, vehicle={"driving_side": "right"}))
    assert np.array_equal(plain.R_vehicle_from_sensor, leaning.R_vehicle_from_sensor)


def test_to_the_letter_one_threshold_rules_the_static_test(rows: Rows) -> None:
    letter = {"method_a": MethodASettings(to_the_letter=True)}
    none = {"threshold": (0.001,) * 3, "threshold_at_zero_speed": (1.2,) * 3}
    assert run(rows, published(letter, static=none)).details["stops"] == 0
    assert run(rows, published(letter)).details["stops"] > 0


def test_to_the_letter_no_manoeuvre_counts_less_for_disagreeing() -> None:
    pointers = np.exp(1j * np.radians([0.0, 0.0, 0.0, 0.0, 40.0]))
    plain = combined(pointers, robust=False)
    assert plain is not None
    assert plain.value == pytest.approx(np.angle(pointers.sum()))
    assert combined(pointers).value < plain.value
    assert not PublishedSettings().to_the_letter().robust


@pytest.mark.slow
def test_a_known_crown_is_taken_off_the_roll(rows: Rows) -> None:
    plain = run(rows)
    leaning_right = {"driving_side": "right", "crown_percent": 1.2, "crown_spread_percent": 0.6}
    leaning = run(rows, published(vehicle=leaning_right))
    assert plain.R_vehicle_from_sensor is not None
    assert leaning.R_vehicle_from_sensor is not None
    turn = leaning.R_vehicle_from_sensor @ plain.R_vehicle_from_sensor.T
    assert vector_from_rotation(turn) == pytest.approx([-0.012, 0.0, 0.0], abs=1e-9)
    assert (leaning.std or (9.0,))[0] < (plain.std or (0.0,))[0]
