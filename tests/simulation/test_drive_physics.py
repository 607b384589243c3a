"""Drives against mechanics that the simulation does not use: energy, circles, rigid motion."""

import time

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucald.core.errors import ConfigError
from imucald.core.rotations import rotation_from_angles
from imucald.core.samples import GRAVITY
from imucald.simulation import VehicleModel, simulate
from imucald.simulation.single_track import handle

QUIET = {
    "accel.vibration": False,
    "accel.noise_density": 0.0,
    "accel.lsb": 0.0,
    "accel.lowpass_hz": None,
    "accel.jitter_s": 0.0,
    "gyro.vibration": False,
    "gyro.noise_density": 0.0,
    "gyro.lsb": 0.0,
    "gyro.lowpass_hz": None,
    "gyro.jitter_s": 0.0,
    "road.roughness": False,
}
LEVEL = {"road.grade": False, "road.bank": False}


def model(**changes):
    return VehicleModel().with_changes(
        QUIET | {k.replace("__", "."): v for k, v in changes.items()}
    )


def test_parked_on_level_road_feels_gravity_in_the_sensors_axes_plus_bias():
    m = model(
        route__kind="parked",
        mount__roll_deg=20.0,
        mount__pitch_deg=-10.0,
        mount__yaw_deg=130.0,
        accel__bias=(0.1, -0.2, 0.3),
        gyro__bias=(0.01, 0.02, -0.03),
    ).with_changes(LEVEL)
    samples = simulate(m, 1, 0.5).samples
    R = Rotation.from_euler("ZYX", [130.0, -10.0, 20.0], degrees=True).as_matrix()
    expected = R.T @ [0.0, 0.0, GRAVITY] + [0.1, -0.2, 0.3]
    np.testing.assert_allclose(
        samples["accel"].values, np.tile(expected, (len(samples["accel"].t), 1)), atol=1e-12
    )
    np.testing.assert_allclose(samples["gyro"].values, [[0.01, 0.02, -0.03]] * 3000, atol=1e-12)


def test_parked_on_a_slope_leans_as_a_body_on_it():
    slope, fall = 0.05, 0.03
    m = model(
        route__kind="parked",
        road__grade_rms=0.0,
        road__grade_mean=slope,
        road__bank_rms=0.0,
        road__crown_mean=fall,
        suspension__squat_dive=False,
        suspension__body_roll=False,
    )
    force = simulate(m, 1, 0.1).truth.force[-1]
    # Nose up: gravity pulls back, so the seat pushes forward. Right side low: it pushes left.
    # A standing tyre creeps by its regularised slip, hence not to the last digit.
    assert force[0] == pytest.approx(GRAVITY * slope / np.hypot(1.0, slope), rel=1e-6)
    assert force[1] / force[2] == pytest.approx(fall, rel=1e-9)
    assert np.linalg.norm(force) == pytest.approx(GRAVITY, rel=1e-12)


def test_crown_falls_to_the_kerb_of_each_driving_side():
    sides = {}
    for side in ("right", "left"):
        truth = simulate(model(route__driving_side=side, road__bank_rms=0.0), 2, 4.0).truth
        sides[side] = truth.mean_crown()
    assert sides["right"] > 0.008
    assert sides["left"] < -0.008


def test_levelled_accelerometer_integrates_to_the_speed_over_a_drive():
    m = model(suspension__squat_dive=False, suspension__body_roll=False).with_changes(LEVEL)
    drive = simulate(m, 3, 10.0)
    t, force = drive.samples["accel"].t, drive.samples["accel"].values
    truth = drive.truth
    # dv/dt = f_x + r v_y, and the sideslip is from the truth.
    slip = np.interp(t, truth.t, truth.yaw_rate * truth.lateral_velocity)
    gained = np.concatenate(([0.0], np.cumsum(0.5 * np.diff(t) * (force[1:, 0] + force[:-1, 0]
             + slip[1:] + slip[:-1]))))  # fmt: skip
    speed = np.interp(t, truth.t, truth.speed)
    assert np.max(np.abs(gained - (speed - speed[0]))) < 0.02


def test_gyro_integrates_to_the_heading():
    m = model(suspension__squat_dive=False, suspension__body_roll=False).with_changes(LEVEL)
    drive = simulate(m, 4, 10.0)
    t, rate = drive.samples["gyro"].t, drive.samples["gyro"].values[:, 2]
    turned = np.sum(0.5 * np.diff(t) * (rate[1:] + rate[:-1]))
    heading = np.interp(t, drive.truth.t, drive.truth.heading)
    assert -turned == pytest.approx(heading[-1] - heading[0], abs=2e-3)


def test_steady_circle_gives_centripetal_force_roll_angle_and_understeer():
    m = model(
        route__kind="circles",
        route__speed_wander=0.0,
        route__steering_wander_mps2=0.0,
        route__circle_radius_m=30.0,
        route__lateral_mps2=(3.0, 3.0),
        chassis__tyre_saturation=False,
    ).with_changes(LEVEL)
    truth = simulate(m, 5, 2.0).truth
    steady = (truth.t > 60.0) & (truth.t < 88.0)
    v, r = np.mean(truth.speed[steady]), np.mean(truth.yaw_rate[steady])
    assert v * v / 30.0 == pytest.approx(0.95**2 * 3.0, rel=1e-3)
    assert r == pytest.approx(v / 30.0, rel=5e-4)
    roll = np.mean(truth.body_roll[steady])
    assert roll == pytest.approx(m.suspension.roll_gradient * v * r, rel=1e-4)
    body = np.mean(truth.force[steady], axis=0)
    expected = np.cos(roll) * v * r + np.sin(roll) * GRAVITY
    assert body[1] == pytest.approx(expected, rel=5e-4)
    steer = np.mean(truth.steer[steady])
    chassis = m.chassis
    assert steer == pytest.approx(
        chassis.wheelbase_m / 30.0 + chassis.understeer_gradient * v * r, rel=5e-4
    )
    # Sideslip of the centre of gravity: l_r / R - m l_f a / (C_r L).
    share = chassis.mass_kg * chassis.cg_to_front_m * v * r
    slip = chassis.cg_to_rear_m / 30.0 - share / (
        chassis.rear_cornering_stiffness_npr * chassis.wheelbase_m
    )
    assert np.mean(truth.lateral_velocity[steady]) / v == pytest.approx(slip, rel=2e-3)


def test_squat_and_dive_follow_the_gradients():
    m = model(route__kind="straight_only", route__gear_shifts=False).with_changes(LEVEL)
    truth = simulate(m, 6, 6.0).truth
    settled = np.abs(np.gradient(truth.acceleration, truth.t)) < 0.05
    for chosen, gradient in (
        (settled & (truth.acceleration > 0.8), m.suspension.squat_gradient),
        (settled & (truth.acceleration < -0.8), m.suspension.dive_gradient),
    ):
        assert chosen.sum() > 200
        ratio = truth.body_pitch[chosen] / truth.acceleration[chosen]
        assert np.median(ratio) == pytest.approx(-gradient, rel=0.02)


def test_force_at_the_sensor_is_the_second_derivative_of_its_place():
    """Everything at once: the sensor's track in earth axes, differentiated numerically."""
    rate = 400.0
    m = model(
        grid_hz=rate,
        accel__rate_hz=rate,
        route__kind="city",
        route__standing_first_s=2.0,
        mount__lever_arm_m=(1.3, -0.5, 0.8),
        road__grade_rms=0.05,
        road__grade_length_m=30.0,
        road__bank_rms=0.04,
        road__bank_length_m=20.0,
    )
    truth = simulate(m, 11, 2.5).truth
    assert np.max(np.abs(truth.speed * truth.yaw_rate)) > 1.0
    # x north, y west, z up; heading is clockwise.
    R_earth_from_road = Rotation.from_euler(
        "ZYX", np.column_stack((-truth.heading, truth.road_pitch, truth.road_roll))
    )
    lean = np.column_stack((truth.body_pitch, truth.body_roll))
    R_earth_from_body = R_earth_from_road * Rotation.from_euler("YX", lean)
    still = np.zeros(len(truth.t))
    velocity = R_earth_from_road.apply(
        np.column_stack((truth.speed, truth.lateral_velocity, still))
    )
    arm = R_earth_from_body.apply([1.3, -0.5, 0.8])
    velocity += np.gradient(arm, 1.0 / rate, axis=0)
    acceleration = np.gradient(velocity, 1.0 / rate, axis=0)
    force = R_earth_from_body.inv().apply(acceleration + np.array([0.0, 0.0, GRAVITY]))
    error = (force - truth.force)[10:-10]
    assert np.max(np.abs(truth.force - truth.reference_force)) > 0.2
    assert np.sqrt(np.mean(error**2)) < 2e-3
    assert np.max(np.abs(error)) < 0.05


def test_angular_rate_is_that_of_the_attitude():
    rate = 400.0
    m = model(grid_hz=rate, accel__rate_hz=rate, route__kind="city", road__bank_rms=0.05)
    truth = simulate(m, 12, 2.0).truth
    R = Rotation.from_euler(
        "ZYX", np.column_stack((-truth.heading, truth.road_pitch, truth.road_roll))
    ) * Rotation.from_euler("YX", np.column_stack((truth.body_pitch, truth.body_roll)))
    turned = (R[:-1].inv() * R[1:]).as_rotvec() * rate
    middle = 0.5 * (truth.rate[:-1] + truth.rate[1:])
    assert np.max(np.abs(turned - middle)) < 2e-3


def test_tyres_saturate_at_the_friction_limit():
    """Steering ever further at constant speed: the lateral force ends at friction * g."""
    t = np.arange(0.0, 20.0, 0.005)
    chassis = model(chassis__friction=0.5, chassis__understeer_gradient=0.004).chassis
    steer = 0.12 * t / 20.0
    found = handle(chassis, np.full(len(t), 15.0), steer, np.zeros(len(t)), 200.0)
    felt = found.lateral_velocity_rate + 15.0 * found.yaw_rate
    assert np.max(felt) < 0.5 * GRAVITY
    assert felt[-1] > 0.4 * GRAVITY
    linear = 15.0**2 * 0.12 / (chassis.wheelbase_m + 0.004 * 15.0**2)
    assert linear > 1.4 * felt[-1]


def test_on_a_slippery_road_the_driver_is_gentle_and_stays_on_it():
    truth = simulate(model(chassis__friction=0.25), 7, 10.0).truth
    assert np.max(np.abs(truth.acceleration)) < 0.25 * GRAVITY
    assert np.max(np.abs(truth.speed * truth.yaw_rate)) < 0.25 * GRAVITY
    assert np.max(np.abs(truth.lateral_velocity)) < 2.0


@pytest.mark.slow
def test_a_vehicle_that_slides_off_is_an_error_not_a_number():
    with pytest.raises(ConfigError, match="slides off"):
        simulate(model(chassis__friction=0.15, road__bank_rms=0.3), 7, 10.0)


def test_short_and_endless_drives_are_refused():
    for minutes in (0.0, -1.0, 0.01, float("nan"), float("inf")):
        with pytest.raises(ConfigError, match="a second"):
            simulate(VehicleModel(), 1, minutes)


def test_each_effect_can_be_switched_off():
    off = {
        "chassis.single_track": False,
        "suspension.squat_dive": False,
        "suspension.body_roll": False,
        "mount.lever_arm": False,
        "mount.lever_arm_m": (1.0, 1.0, 1.0),
    }
    truth = simulate(model().with_changes(LEVEL | off), 8, 3.0).truth
    np.testing.assert_allclose(truth.force[:, 0], truth.acceleration, atol=1e-12)
    np.testing.assert_allclose(truth.force[:, 1], truth.speed * truth.yaw_rate, atol=1e-12)
    np.testing.assert_allclose(truth.force[:, 2], GRAVITY, atol=1e-12)
    np.testing.assert_allclose(truth.rate[:, :2], 0.0, atol=1e-15)


def test_mount_shift_turns_the_sensor_about_vehicle_axes_from_its_time_on():
    shifted = model(
        mount__yaw_deg=40.0,
        mount__roll_deg=5.0,
        mount__shifts=({"t_s": 60.0, "yaw_deg": 5.0}, {"t_s": 90.0, "pitch_deg": -3.0}),
    )
    drive = simulate(shifted, 9, 2.0)
    series = drive.samples["accel"]
    in_vehicle = [np.interp(series.t, drive.truth.t, drive.truth.force[:, i]) for i in range(3)]
    R0 = rotation_from_angles(np.radians(5.0), 0.0, np.radians(40.0))
    R1 = rotation_from_angles(0.0, 0.0, np.radians(5.0)) @ R0
    R2 = rotation_from_angles(0.0, np.radians(-3.0), 0.0) @ R1
    for low, high, R in ((1.0, 60.0, R0), (60.0, 90.0, R1), (90.0, 119.0, R2)):
        use = (series.t >= low) & (series.t < high)
        found = series.values[use] @ R.T
        np.testing.assert_allclose(found, np.column_stack(in_vehicle)[use], atol=5e-3)
    np.testing.assert_allclose(drive.truth.R_vehicle_from_sensor(), R2, atol=1e-15)
    np.testing.assert_allclose(drive.truth.R_vehicle_from_sensor(59.0), R0, atol=1e-15)


def test_seed_decides_everything():
    first, again, other = (simulate(VehicleModel(), seed, 1.0) for seed in (1, 1, 2))
    for channel, series in first.samples.items():
        np.testing.assert_array_equal(series.t, again.samples[channel].t)
        np.testing.assert_array_equal(series.values, again.samples[channel].values)
    assert not np.array_equal(first.truth.speed, other.truth.speed)


def test_switching_one_effect_leaves_the_draws_of_the_others():
    plain = simulate(VehicleModel(), 3, 2.0)
    smooth = simulate(VehicleModel().with_changes({"road.roughness": False}), 3, 2.0)
    np.testing.assert_array_equal(plain.truth.speed, smooth.truth.speed)
    np.testing.assert_array_equal(plain.truth.road_pitch, smooth.truth.road_pitch)
    np.testing.assert_array_equal(plain.samples["steering"].t, smooth.samples["steering"].t)


def test_a_hundred_times_faster_than_real_time():
    began = time.process_time()
    simulate(VehicleModel(), 1, 10.0)
    assert time.process_time() - began < 6.0
