"""The second generator obeys the physics that it claims, and hides what it says it hides."""

from __future__ import annotations

import ast
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hidden import CAUSES, OUTSIDE, SIZES, TOLERANCES, Effect, HiddenDrive, hidden_drive
from imucald.core.samples import GRAVITY
from imucald.model.model import model_from_mapping

pytestmark = pytest.mark.slow

Array = NDArray[np.float64]
SEED, MINUTES = 11, 4.0
RATE = 200.0


@cache
def drive(*effects: Effect) -> HiddenDrive:
    return hidden_drive(SEED, effects, MINUTES)


def smooth(x: Array, seconds: float = 0.8) -> Array:
    n = round(seconds * RATE)
    return np.convolve(x, np.ones(n) / n, "same")


def changed_signals(effect: Effect) -> set[str]:
    """Signals that are not, bit for bit, those of the same drive without the effect."""
    with_it, without = drive(effect).samples, drive().samples
    return {
        name
        for name, series in without.items()
        if not (
            np.array_equal(series.t, with_it[name].t)
            and np.array_equal(series.values, with_it[name].values)
        )
    }


# physics ---------------------------------------------------------------------------------------


def test_at_rest_only_gravity_is_felt() -> None:
    d = drive()
    rest = smooth((d.speed != 0.0).astype(float), 2.0) == 0.0
    assert rest.mean() > 0.02
    np.testing.assert_allclose(np.linalg.norm(d.force[rest], axis=1), GRAVITY, atol=0.03)
    np.testing.assert_allclose(d.rate[rest], 0.0, atol=0.003)


def test_the_path_turns_as_the_yaw_rate_says() -> None:
    d = drive()
    step = np.diff(d.position, axis=0)
    moving = np.linalg.norm(step[:, :2], axis=1) * RATE > 3.0
    forward = np.sign(d.speed[:-1])
    course = np.arctan2(forward * step[:, 1], forward * step[:, 0])
    ahead = np.angle(np.exp(1j * (course - d.heading[:-1])))[moving]
    # What is left is the sideslip.
    assert np.abs(ahead).max() < 0.21
    turned = d.heading[-1] - d.heading[0]
    assert np.sum(d.rate[:, 2]) / RATE == pytest.approx(turned, abs=0.02 + 0.002 * abs(turned))


def test_navigating_by_force_and_rate_leads_back_to_the_speed() -> None:
    """Strapdown integration with quaternions, from rest: attitude, then velocity."""
    d = drive()
    w, f = d.rate, d.force
    arm = drive().parameters
    lever = np.array([arm[f"mount.lever_arm_m.{i}"] for i in range(3)])
    start, stop = 0, int(60 * RATE)
    up = f[:200].mean(axis=0) / np.linalg.norm(f[:200].mean(axis=0))
    q = np.array([1.0 + up[2], up[1], -up[0], 0.0])
    q /= np.linalg.norm(q)
    v = np.zeros(3)
    error = []
    for k in range(start, stop):
        half = 0.5 * w[k] / RATE
        x, y, z = half
        a, b, c, e = q
        q = q + np.array(
            [-b * x - c * y - e * z, a * x + c * z - e * y, a * y - b * z + e * x,
             a * z + b * y - c * x]
        )  # fmt: skip
        q /= np.linalg.norm(q)
        a, u = q[0], q[1:]
        turned = f[k] + 2.0 * np.cross(u, np.cross(u, f[k]) + a * f[k])
        v = v + (turned - [0.0, 0.0, GRAVITY]) / RATE
        nose = np.array([1.0, 0.0, 0.0])
        nose = nose + 2.0 * np.cross(u, np.cross(u, nose) + a * nose)
        error.append(v @ nose - (d.speed[k] - w[k, 2] * lever[1]))
    assert d.speed[:stop].max() > 8.0
    assert np.abs(error).max() < 0.35


def test_force_follows_the_acceleration() -> None:
    d = drive()
    moving = np.abs(d.speed) > 2.0
    x, y = smooth(np.gradient(d.speed) * RATE), smooth(d.reference_force[:, 0])
    gain = np.polyfit(x[moving], y[moving], 1)[0]
    # Squat lets a part of gravity in: g times the gradient.
    assert gain == pytest.approx(1.0 + GRAVITY * 0.0038, abs=0.02)


def test_lever_arm_adds_what_a_turning_body_adds() -> None:
    effect = Effect("lever_arm", "large")
    moved, honest = drive(effect), drive()
    keys = [f"mount.lever_arm_m.{i}" for i in range(3)]
    arm = np.array([moved.parameters[k] - honest.parameters[k] for k in keys])
    w = honest.rate
    turning = np.gradient(w, axis=0) * RATE
    expected = np.cross(turning, arm) + np.cross(w, np.cross(w, arm))
    found = moved.force - honest.force
    for i in range(3):
        e, f = smooth(expected[:, i], 0.1)[20:-20], smooth(found[:, i], 0.1)[20:-20]
        assert np.std(e - f) < 0.03 * np.std(e)


def test_steering_is_that_of_the_understeer_gradient() -> None:
    d = drive(Effect("understeer", "large"))
    steering, speed = d.samples["steering"], d.speed
    wheel = np.interp(d.t, steering.t, steering.values) / d.parameters["chassis.steering_ratio"]
    slow = [smooth(x, 3.0) for x in (wheel, d.rate[:, 2], d.reference_force[:, 1], speed)]
    steady = (speed > 8.0) & (np.abs(smooth(np.gradient(slow[1]) * RATE, 2.0)) < 0.03)
    wheel, yaw, force, v = (x[steady] for x in slow)
    length = d.model["chassis"]["wheelbase_m"]
    gradient = np.polyfit(force, wheel - length * yaw / v, 1)[0]
    # Tyres give way as they near their limit, so a little more.
    assert gradient == pytest.approx(d.parameters["chassis.understeer_gradient"], rel=0.15)


def test_body_leans_by_its_gradients() -> None:
    d = drive()
    moving = np.abs(d.speed) > 2.0
    force, roll = smooth(d.reference_force[:, 1]), smooth(d.body_roll)
    gradient = np.polyfit(force[moving], roll[moving], 1)[0]
    # reference_force is felt in the leaning body, which feels more: by 1 + g * gradient.
    assert gradient == pytest.approx(d.parameters["suspension.roll_gradient"], rel=0.12)


def test_road_is_as_rough_and_steep_as_asked() -> None:
    effects = (Effect("road_grade", "medium"), Effect("road_bank", "medium"))
    realised = [hidden_drive(seed, effects, 20.0).parameters for seed in range(3)]
    for key, cause in (("road.grade_rms", "road_grade"), ("road.bank_rms", "road_bank")):
        for p in realised:
            assert p[key] == pytest.approx(SIZES[cause][1], rel=0.3)


# the baseline ----------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_honest_drive_is_within_the_tolerances(seed: int) -> None:
    d = hidden_drive(seed, minutes=2.0)
    model = model_from_mapping(dict(d.model), "baseline").dump()
    for key, value in d.parameters.items():
        head, _, tail = key.partition(".")
        bound = TOLERANCES.get(key, TOLERANCES.get(key.rpartition(".")[0]))
        if bound is None or key.startswith(("road.grade", "road.bank", "mount.rotation")):
            continue
        name, _, index = tail.partition(".")
        stated = model[head][name][int(index)] if index else model[head][name]
        if key == "chassis.steering_ratio":
            bound *= stated
        assert abs(value - stated) <= bound * 1.0001, key
    turned = np.array([d.parameters[f"mount.rotation_deg.{i}"] for i in range(3)])
    assert np.all(np.abs(turned) <= np.degrees(TOLERANCES["mount.rotation"]) * 1.001)


def test_mount_of_the_model_file_is_the_one_that_levels_the_signals() -> None:
    d = drive()
    accel = d.samples["accel"]
    still = np.interp(accel.t, d.t, np.abs(d.speed)) == 0.0
    level = d.R_vehicle_from_sensor @ accel.values[still].mean(axis=0)
    rest = d.speed == 0.0
    np.testing.assert_allclose(level, d.force[rest].mean(axis=0), atol=0.12)


def test_the_same_seed_is_the_same_drive() -> None:
    a, b = hidden_drive(5, minutes=1.5), hidden_drive(5, minutes=1.5)
    assert all(np.array_equal(a.samples[k].values, b.samples[k].values) for k in a.samples)
    other = hidden_drive(6, minutes=1.5)
    assert not np.array_equal(a.samples["speed"].values, other.samples["speed"].values)


# what is hidden --------------------------------------------------------------------------------

ONLY: dict[str, set[str]] = {
    "mount_rotation": {"accel", "gyro"},
    "mount_shift": {"accel", "gyro"},
    "accel_bias": {"accel"},
    "accel_scale": {"accel"},
    "accel_cross_axis": {"accel"},
    "gyro_bias": {"gyro"},
    "gyro_scale": {"gyro"},
    "gyro_bias_temperature": {"gyro"},
    "steering_offset": {"steering"},
    "steering_ratio": {"steering"},
    "wheel_speed_scale": {"speed", "wheel_speeds"},
    "yaw_rate_scale": {"yaw_rate"},
    "yaw_rate_offset": {"yaw_rate"},
    "g_sensitivity": {"gyro"},
    "clock_drift": {"accel", "gyro"},
    "vibration_rectification": {"accel"},
}
FORMS = ("signal_delay", "sensor_lowpass", "saturation", "dropouts", "stuck_signal")


@pytest.mark.parametrize("cause", sorted(ONLY))
def test_effect_of_a_sensor_is_seen_in_its_signals_only(cause: str) -> None:
    assert changed_signals(Effect(cause, "medium")) == ONLY[cause]


@pytest.mark.parametrize("cause", FORMS)
@pytest.mark.parametrize("signal", ["gyro", "yaw_rate"])
def test_effect_of_one_signal_is_seen_in_that_alone(cause: str, signal: str) -> None:
    assert changed_signals(Effect(cause, "large", signal)) == {signal}


def test_lever_arm_is_seen_by_the_accelerometer() -> None:
    """The gyroscope sees it by its g-sensitivity, within its steps."""
    with_it, without = drive(Effect("lever_arm", "large")).samples, drive().samples
    for name, series in without.items():
        change = float(np.abs(series.values - with_it[name].values).max())
        assert change > 0.1 if name == "accel" else change <= (0.00071 if name == "gyro" else 0.0)


@pytest.mark.parametrize("cause", [*CAUSES, *OUTSIDE])
def test_every_effect_changes_the_drive_and_says_by_how_much(cause: str) -> None:
    effect = Effect(cause, "small")
    assert changed_signals(effect)
    assert set(drive(effect).truth) == {cause}
    assert bool(drive(effect).truth[cause]) == (cause in CAUSES)


SCALARS: list[tuple[str, Callable[[HiddenDrive], float]]] = [
    ("steering_offset", lambda d: d.parameters["steering.offset"]),
    ("wheel_speed_scale", lambda d: d.parameters["speed.scale"]),
    ("yaw_rate_scale", lambda d: d.parameters["yaw_rate.scale"]),
    ("yaw_rate_offset", lambda d: d.parameters["yaw_rate.offset"]),
    ("squat_dive", lambda d: d.parameters["suspension.squat_gradient"]),
    ("body_roll", lambda d: d.parameters["suspension.roll_gradient"]),
    ("understeer", lambda d: d.parameters["chassis.understeer_gradient"]),
]


@pytest.mark.parametrize(("cause", "value"), SCALARS, ids=[name for name, _ in SCALARS])
def test_truth_differs_by_the_size_asked_for(
    cause: str, value: Callable[[HiddenDrive], float]
) -> None:
    for i, size in enumerate(("small", "medium", "large")):
        changed = abs(value(drive(Effect(cause, size))) - value(drive()))  # type: ignore[arg-type]
        assert changed == pytest.approx(SIZES[cause][i], rel=0.1001)


def test_mount_turns_by_the_angle_asked_for() -> None:
    d = drive(Effect("mount_rotation", "large"))
    turned = d.R_vehicle_from_sensor @ drive().R_vehicle_from_sensor.T
    angle = np.arccos(0.5 * (np.trace(turned) - 1.0))
    assert angle == pytest.approx(SIZES["mount_rotation"][2], rel=0.1001)
    shifted = drive(Effect("mount_shift", "medium"))
    (_, before), (when, after) = shifted.mounts
    angle = np.arccos(0.5 * (np.trace(after @ before.T) - 1.0))
    assert angle == pytest.approx(SIZES["mount_shift"][1], rel=0.1001)
    assert 0.25 <= when / (60.0 * MINUTES) <= 0.75
    accel, honest = shifted.samples["accel"], drive().samples["accel"]
    changed = np.any(accel.values != honest.values, axis=1)
    assert not changed[accel.t < when - 0.05].any()
    assert changed[accel.t > when + 0.05].mean() > 0.9


def test_delay_is_one() -> None:
    late, honest = (d.samples["yaw_rate"] for d in (
        drive(Effect("signal_delay", "medium", "yaw_rate")), drive()))  # fmt: skip
    t = np.arange(10.0, 60.0 * MINUTES - 10.0, 0.02)
    y = np.interp(t, late.t, late.values)
    shifts = np.arange(0.0, 0.3, 0.005)
    misfit = [np.std(y - np.interp(t - s, honest.t, honest.values)) for s in shifts]
    best = shifts[int(np.argmin(misfit))]
    assert best == pytest.approx(SIZES["signal_delay"][1], rel=0.12)


def test_lowpass_takes_what_a_second_order_filter_takes() -> None:
    slow, honest = (d.samples["gyro"] for d in (
        drive(Effect("sensor_lowpass", "small", "gyro")), drive()))  # fmt: skip
    cutoff = drive(Effect("sensor_lowpass", "small", "gyro")).parameters["gyro.lowpass_hz"]
    f = np.fft.rfftfreq(len(honest.t), 0.01)
    before, after = (np.fft.rfft(s.values[:, 0]) for s in (honest, slow))
    near = np.abs(f / cutoff - 1.0) < 0.1
    below = (f > 0.02) & (f < 0.3 * cutoff)
    half = np.sum(np.abs(after[near]) ** 2) / np.sum(np.abs(before[near]) ** 2)
    assert half == pytest.approx(0.5, abs=0.07)
    assert np.sum(np.abs(after[below]) ** 2) / np.sum(np.abs(before[below]) ** 2) > 0.97


@pytest.mark.parametrize("signal", ["accel", "gyro", "yaw_rate"])
def test_saturation_holds_the_share_on_the_rail(signal: str) -> None:
    d = drive(Effect("saturation", "large", signal))
    series, rail = d.samples[signal], d.parameters[f"{signal}.full_scale"]
    size = np.abs(series.values).reshape(len(series.t), -1).max(axis=1)
    moving = np.interp(series.t, d.t, np.abs(d.speed)) > 1.0
    assert size.max() <= rail * 1.001 + 1e-3
    share = np.mean(size[moving] >= rail - 0.002)
    assert share == pytest.approx(SIZES["saturation"][2], rel=0.25)


def test_lost_and_frozen_frames_are_as_many_as_asked() -> None:
    lossy = drive(Effect("dropouts", "large", "speed"))
    full = 50.0 * 60.0 * MINUTES
    assert 1.0 - len(lossy.samples["speed"].t) / full == pytest.approx(0.08, rel=0.2)
    frozen = drive(Effect("stuck_signal", "large", "gyro")).samples["gyro"]
    still = np.all(np.diff(frozen.values, axis=0) == 0.0, axis=1)
    assert still.mean() == pytest.approx(0.12, rel=0.25)


def test_clocks() -> None:
    cycle = drive(Effect("clock_drift", "large", "cycle"))
    period = float(np.polyfit(np.arange(len(cycle.samples["accel"].t)),
                              cycle.samples["accel"].t, 1)[0])  # fmt: skip
    # The single lost frames lengthen the mean period by their share.
    assert abs(period / 0.01 - 1.0) == pytest.approx(5000e-6, rel=0.2)
    stamps = drive(Effect("clock_drift", "large", "stamps"))
    ahead = stamps.samples["gyro"].t / drive().samples["gyro"].t - 1.0
    assert np.abs(ahead).mean() == pytest.approx(600e-6, rel=0.11)


def test_two_effects_stand_side_by_side() -> None:
    both = drive(Effect("accel_bias", "large"), Effect("steering_offset", "large"))
    assert set(both.truth) == {"accel_bias", "steering_offset"}
    assert abs(both.parameters["steering.offset"]) > 0.15
    bias = [both.parameters[f"accel.bias.{i}"] for i in range(3)]
    assert np.linalg.norm(bias) == pytest.approx(0.6, rel=0.2)


def test_shares_nothing_with_what_it_tests() -> None:
    """Only the container of samples comes from the package."""
    for path in (Path(__file__).parent.parent / "hidden").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module:
                assert not node.module.startswith(("scipy",)), path
                if node.module.startswith("imucald"):
                    assert node.module == "imucald.core.samples", path
            elif isinstance(node, ast.Import):
                assert not any(a.name.startswith(("imucald", "scipy")) for a in node.names), path
