"""What is wrong with sensor or mount must not come out as good; on simulated drives."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from test_estimator import GOOD, drive, usual

from imucald.config.calibration import OrientationSettings
from imucald.core.rotations import rotation_from_vector
from imucald.core.samples import Samples, Series
from imucald.motion.column_ticks import ticks_from_samples
from imucald.mount.carried_force import CarriedForce
from imucald.mount.contradictions import StandingFault
from imucald.mount.estimate import MountState
from imucald.mount.estimator import JointEstimator
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.joint.evidence import Evidence
from imucald.mount.restored import RestoredEstimator, StoredMount
from mount_settings import joint_settings

MINUTES = 8.0


def edited(**changes: NDArray[np.float64]) -> Samples:
    """Samples of the usual drive with channels multiplied by a matrix, or by a number."""
    samples = dict(drive().samples)
    for channel, factor in changes.items():
        series = samples[channel]
        samples[channel] = Series(series.t, series.values @ np.asarray(factor).T
                                  if np.ndim(factor) else series.values * factor)  # fmt: skip
    return samples


def turned(samples: Samples, at: float, vector: tuple[float, float, float]) -> Samples:
    """The sensor turned about vehicle axes at a time; no gyroscope sees it."""
    R = drive().truth.R_vehicle_from_sensor()
    matrix = R.T @ rotation_from_vector(np.array(vector)).T @ R
    out = dict(samples)
    for channel in ("accel", "gyro"):
        series = samples[channel]
        late = (series.t >= at)[:, None]
        values = np.where(late, series.values @ matrix.T, series.values)
        out[channel] = Series(series.t, values)
    return out


def states(
    samples: Samples, minutes: float = MINUTES, settings: EstimatorSettings | None = None
) -> tuple[JointEstimator, list[MountState]]:
    estimator, found = JointEstimator(settings or joint_settings()), []
    for row in ticks_from_samples(samples, 0, int(minutes * 600), {}).tolist():
        estimator.step(row)
        found.append(estimator.state)
    return estimator, found


FLIP, SWAP = np.diag([1.0, 1.0, -1.0]), np.eye(3)[[1, 0, 2]]
SWAPS = {"x, y": SWAP, "y, z": np.eye(3)[[0, 2, 1]], "z, x": np.eye(3)[[2, 1, 0]]}
CONTRADICTIONS = {
    "all accelerometer signs": ({"accel": -np.eye(3)}, StandingFault.TURN_YAW_RATE),
    "one accelerometer sign": ({"accel": FLIP}, StandingFault.TURN_YAW_RATE),
    "accelerometer axes exchanged": ({"accel": SWAP}, StandingFault.FORCE_TURNS),
    "handedness": ({"accel": SWAP, "gyro": SWAP}, None),
    **{
        f"gyroscope {axes} exchanged": ({"gyro": swap}, StandingFault.GYRO_AXES)
        for axes, swap in SWAPS.items()
    },
    "gyroscope signs": ({"gyro": -np.eye(3)}, StandingFault.GYRO_AXES),
    "gyroscope in deg/s": ({"gyro": 57.3 * np.eye(3)}, None),
    "gyroscope 25 times": ({"gyro": 25.0 * np.eye(3)}, StandingFault.GYRO_GAIN),
    "speed x 3.6": ({"speed": 3.6}, StandingFault.SPEED_GAIN),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", list(CONTRADICTIONS))
def test_a_contradiction_is_never_good_and_has_a_name(name):
    changes, fault = CONTRADICTIONS[name]
    estimator, found = states(edited(**changes))
    assert not any(state in GOOD for state in found)
    assert estimator.estimate().faults
    if fault is not None:
        assert fault.value in estimator.estimate().faults


def without(samples: Samples, *channels: str) -> dict[str, Series]:
    return {name: series for name, series in samples.items() if name not in channels}


@pytest.mark.slow
@pytest.mark.parametrize("since", [0.0, 200.0], ids=["turned round", "stuck on"])
def test_reverse_that_is_on_while_driving_fast_is_a_fault_and_the_turned_mount_never_good(since):
    samples = without(drive().samples, "steering")
    t = np.arange(0.0, 60.0 * MINUTES, 0.1)
    samples["reverse"] = Series(t, (t >= since).astype(float))
    estimator, found = states(samples)
    assert estimator.faults == (StandingFault.REVERSE.value,)
    assert not any(state in GOOD for state in found[int(10.0 * (since + 60.0)) :])
    if not since:
        assert not any(state in GOOD for state in found)


@pytest.mark.slow
def test_a_speed_with_the_wrong_sign_is_the_same_fault():
    estimator, found = states(without(edited(speed=-1.0), "steering", "reverse"))
    assert estimator.faults == (StandingFault.REVERSE.value,)
    assert not any(state in GOOD for state in found)


@pytest.mark.slow
@pytest.mark.parametrize("lost", [("speed", "yaw_rate"), ("speed",), ("yaw_rate",)])
def test_a_message_of_the_vehicle_that_stops_is_no_moved_sensor(lost):
    samples = dict(drive().samples)
    for channel in lost:
        series = samples[channel]
        is_there = series.t < 200.0
        samples[channel] = Series(series.t[is_there], series.values[is_there])
    estimator, found = states(samples)
    assert found[1990] in GOOD
    assert all(state in GOOD for state in found[2000:])
    assert not estimator.estimate().details["shifts"]
    assert not estimator.faults


SIDED = ("yaw_rate", "steering", "lateral_accel", "wheel_speeds", "heading")


@pytest.mark.slow
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_without_left_and_right_a_drive_or_its_mirror_image_is_usable_and_never_fine(sign):
    samples = without(drive(minutes=15.0).samples, *SIDED)
    series = samples["accel"]
    samples = {**samples, "accel": Series(series.t, sign * series.values)}
    estimator, found = states(samples, minutes=15.0)
    assert found[-1] is MountState.USABLE
    assert MountState.FINE not in found
    estimate = estimator.estimate()
    assert estimate.details["not_checked"]
    assert set(estimate.waiting_for) == {"roll", "pitch", "yaw"}
    assert all("orientation" in text for text in estimate.waiting_for.values())


@pytest.mark.slow
def test_the_axis_that_points_up_makes_such_a_drive_fine_and_its_mirror_image_a_fault():
    sound = without(drive(minutes=15.0).samples, *SIDED)
    R = drive().truth.R_vehicle_from_sensor()
    axis = int(np.argmax(np.abs(R[2])))
    up = ("" if R[2, axis] > 0.0 else "-") + "xyz"[axis]
    settings = joint_settings({"orientation": OrientationSettings(up=up)})  # type: ignore[arg-type]
    _, found = states(sound, minutes=15.0, settings=settings)
    assert found[-1] is MountState.FINE
    series = sound["accel"]
    mirrored = {**sound, "accel": Series(series.t, -series.values)}
    estimator, found = states(mirrored, minutes=4.0, settings=settings)
    assert not any(state in GOOD for state in found)
    assert estimator.faults == (StandingFault.ORIENTATION.value,)


@pytest.mark.slow
def test_a_stated_forward_axis_that_points_back_is_a_fault_that_no_sign_mends():
    R = drive().truth.R_vehicle_from_sensor()
    axis = int(np.argmax(np.abs(R[0])))
    forward = ("-" if R[0, axis] > 0.0 else "") + "xyz"[axis]
    settings = joint_settings({"orientation": OrientationSettings(forward=forward)})  # type: ignore[arg-type]
    estimator, _ = states(dict(drive().samples), minutes=4.0, settings=settings)
    assert estimator.faults == (StandingFault.FORWARD.value,)
    assert all("sign: -1" not in text for text in estimator.estimate().waiting_for.values())


@pytest.mark.slow
def test_a_yaw_rate_leaves_nothing_unchecked():
    with_yaw_rate, _ = states(dict(drive().samples), minutes=0.5)
    assert not with_yaw_rate.estimate().details["not_checked"]


@pytest.mark.slow
def test_a_sound_drive_has_no_fault_and_becomes_fine():
    estimator, found = states(dict(drive(minutes=15.0).samples), minutes=15.0)
    assert estimator.faults == ()
    assert estimator.estimate().details["faults"] == []
    assert MountState.FINE in found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("axis", "at"), [(0, 150.0), (1, 150.0), (0, 320.0), (1, 320.0), (2, 320.0)]
)
def test_a_turn_by_45_degrees_is_suspect_within_two_minutes_at_any_time(axis, at):
    vector = [0.0, 0.0, 0.0]
    vector[axis] = math.radians(45.0)
    _, found = states(turned(drive().samples, at, (vector[0], vector[1], vector[2])))
    good = np.array([state in GOOD for state in found])
    begun = int(10 * at)
    assert good[begun - 50 : begun].all()
    assert not good[begun : begun + 1200].all()


@pytest.mark.slow
def test_rotations_after_a_turn_are_good_only_when_they_are_right():
    samples = turned(drive().samples, 200.0, (math.radians(20.0), 0.0, 0.0))
    estimator = JointEstimator(joint_settings())
    true = rotation_from_vector([math.radians(20.0), 0.0, 0.0]) @ (
        drive().truth.R_vehicle_from_sensor()
    )
    was_reported, worst = False, 0.0
    for row in ticks_from_samples(samples, 0, int(MINUTES * 600), {}).tolist():
        estimator.step(row)
        was_reported |= row[0] > 200.0 and estimator.state not in GOOD
        if was_reported and estimator.state in GOOD and estimator.correction is not None:
            R = estimator.correction.matrix()
            left = float(np.clip((np.trace(true @ R.T) - 1.0) / 2.0, -1.0, 1.0))
            worst = max(worst, math.degrees(math.acos(left)))
    assert was_reported
    assert worst < 3.0


@pytest.mark.slow
def test_a_creeping_mount_is_named_and_its_interval_holds():
    made = drive(minutes=20.0)
    R = made.truth.R_vehicle_from_sensor()
    rate = math.radians(18.0) / 3600.0
    samples = dict(made.samples)
    for channel in ("accel", "gyro"):
        series = samples[channel]
        turn = np.array([rotation_from_vector([0.0, rate * t, 0.0]).T @ R for t in series.t])
        values = np.einsum("nij,nj->ni", R.T @ turn, series.values)
        samples[channel] = Series(series.t, values)
    estimator, _ = states(samples, minutes=20.0)
    estimate = estimator.estimate()
    details = estimate.details
    moved = bool(details["creep"]) or bool(details["shifts"])
    assert moved
    assert estimate.R_vehicle_from_sensor is not None
    assert estimate.std is not None
    end = rotation_from_vector([0.0, rate * 1200.0, 0.0]) @ R
    error = math.asin(float(np.clip((end @ estimate.R_vehicle_from_sensor.T)[0, 2], -1.0, 1.0)))
    assert abs(error) < 4.0 * estimate.std[1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("owner", "method"),
    [(Evidence, "sudden_change"), (CarriedForce, "take_block")],
    ids=["evidence", "force"],
)
def test_a_factorisation_that_fails_is_counted_and_suspect_and_ends_nothing(
    monkeypatch, owner, method
):
    estimator = JointEstimator(joint_settings())
    rows = ticks_from_samples(drive().samples, 0, 3000, {}).tolist()
    for row in rows[:2000]:
        estimator.step(row)
    assert estimator.state in GOOD

    def fails(*_: object) -> None:
        raise np.linalg.LinAlgError("Singular matrix")

    with monkeypatch.context() as patched:
        patched.setattr(owner, method, fails)
        for row in rows[2000:2200]:
            estimator.step(row)
    assert estimator.state is MountState.SUSPECT
    assert estimator.estimate().faults.count(StandingFault.NUMERICS.value) == 1
    for row in rows[2200:]:
        estimator.step(row)
        assert estimator.state not in GOOD  # 90 s, and new evidence


def test_a_restored_mount_off_the_vertical_is_suspect_while_parked():
    true = drive().truth.R_vehicle_from_sensor()
    stored = rotation_from_vector([math.radians(40.0), 0.0, 0.0]) @ true
    estimator = RestoredEstimator(
        JointEstimator(joint_settings()), StoredMount(stored, np.eye(3) * math.radians(0.3) ** 2)
    )
    standing = ticks_from_samples(drive().samples, 0, 100, {}).tolist()
    for row in standing:
        estimator.step(row)
    assert estimator.state is MountState.SUSPECT


def test_a_restored_mount_that_holds_gravity_upright_stays_restored():
    true = drive().truth.R_vehicle_from_sensor()
    estimator = RestoredEstimator(
        JointEstimator(joint_settings()), StoredMount(true, np.eye(3) * math.radians(0.3) ** 2)
    )
    for row in ticks_from_samples(drive().samples, 0, 300, {}).tolist():
        estimator.step(row)
    assert estimator.state is MountState.RESTORED


@pytest.mark.slow
def test_a_sound_drive_says_no_creep():
    assert usual().estimate().details["creep"] == {}


def test_a_speed_that_the_force_contradicts_claims_no_yaw_and_no_move():
    samples = edited()
    speed = samples["speed"]
    late = speed.t > 240.0  # from then on it grows where the vehicle brakes
    samples["speed"] = Series(speed.t, np.where(late, 40.0 - speed.values, speed.values))
    for channel in ("gyro", "yaw_rate", "steering", "wheels"):
        samples.pop(channel, None)
    estimator, claimed = JointEstimator(joint_settings()), []
    for row in ticks_from_samples(samples, 0, int(MINUTES * 600), {}).tolist():
        estimator.step(row)
        estimate = estimator.estimate()
        if StandingFault.FORCE_SPEED in estimate.faults and estimate.covariance is not None:
            claimed.append(math.degrees(math.sqrt(estimate.covariance[2, 2])))
    assert claimed
    assert min(claimed) > 100.0
    assert estimator.estimate().details["shifts"] == []
