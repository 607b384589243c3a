"""Drives look like driving: speeds, accelerations, manoeuvres, roads."""

import numpy as np
import pytest
from scipy.signal import welch

from imucald.model.vehicle import Chassis, DriveRoute, Road, Suspension
from imucald.simulation import VehicleModel, simulate
from imucald.simulation.driver import drive_route
from imucald.simulation.road import road_attitude, road_roughness


def driven(kind, seed=1, minutes=15.0, **route):
    """Driver alone, 50 Hz: quicker than a whole drive."""
    return drive_route(DriveRoute(kind=kind, **route), seed, 60.0 * minutes, 50.0)


def truth_of(kind, seed=1, minutes=15.0, **changes):
    wanted = {"route.kind": kind} | {k.replace("__", "."): v for k, v in changes.items()}
    return simulate(VehicleModel().with_changes(wanted), seed, minutes).truth


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["mixed", "city", "motorway"])
@pytest.mark.parametrize("seed", [1, 2])
def test_speeds_and_accelerations_are_those_of_drivers(kind, seed):
    truth = truth_of(kind, seed, 12.0)
    lateral = truth.speed * truth.yaw_rate
    assert -3.5 < truth.acceleration.min() < -1.5
    assert 0.8 < truth.acceleration.max() < 2.6
    assert np.max(np.abs(lateral)) < 4.5
    assert np.max(np.abs(lateral)) > 1.2
    assert truth.speed.max() < 36.001
    assert truth.speed.max() > {"city": 12.0, "mixed": 18.0, "motorway": 29.0}[kind]
    jerk = np.gradient(truth.acceleration, truth.t)
    assert np.percentile(np.abs(jerk), 99.5) < 8.0
    # Gentle mostly, as in logs: 0.4-0.5 m/s^2 rms in the two recorded cars, somewhat more here.
    assert 0.3 < np.std(truth.acceleration[truth.speed > 1.0]) < 1.0


def test_a_mixed_drive_contains_every_manoeuvre():
    left = right = stops = slow_turns = fast = 0
    for seed in range(6):
        drive = driven("mixed", seed)
        lateral = drive.speed**2 * drive.curvature
        left += np.sum(lateral > 1.0)
        right += np.sum(lateral < -1.0)
        still = drive.speed == 0.0
        stops += np.sum(np.diff(still.astype(int)) == 1)
        slow_turns += np.sum((np.abs(drive.curvature) > 0.05) & (np.abs(drive.speed) > 3.0))
        fast += np.sum(drive.speed > 22.0)
    assert min(left, right) > 0.3 * max(left, right)
    assert stops >= 18
    assert slow_turns > 800
    assert fast > 800


def test_roundabouts_turn_with_the_traffic():
    turned = {}
    for side in ("right", "left"):
        drive = driven("city", 3, 60.0, driving_side=side)
        inside = (np.abs(drive.curvature) > 0.03) & (drive.speed > 2.0)
        turned[side] = np.sum((drive.speed * drive.curvature)[inside]) / 50.0
    # Around the island more than into and out of it: half a turn to the left, each time.
    assert turned["right"] > turned["left"] + 10.0


def test_standing_first_or_moving_from_the_start():
    standing = driven("mixed", 2, 3.0, standing_first_s=30.0)
    assert np.all(standing.speed[standing.t < 29.0] == 0.0)
    assert np.max(standing.speed[(standing.t > 31.0) & (standing.t < 45.0)]) > 3.0
    moving = driven("mixed", 2, 3.0, standing_first_s=0.0)
    assert moving.speed[0] > 3.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["mixed", "city", "motorway", "straight_only"])
def test_the_drive_goes_on_to_its_end_and_ends_standing(kind):
    for seed in range(25):
        drive = driven(kind, seed, 6.0, standing_last_s=15.0)
        end = drive.t[-1] - np.max(drive.t[drive.speed != 0.0])
        assert 10.0 < end < 120.0
        assert np.mean(drive.speed == 0.0) < 0.75


def test_kinds_keep_their_promise():
    parked = truth_of("parked", minutes=1.0)
    assert np.all(parked.speed == 0.0)
    straight = truth_of("straight_only", minutes=10.0)
    assert np.max(np.abs(straight.speed * straight.yaw_rate)) < 0.6
    assert np.std(straight.acceleration[straight.speed > 1.0]) > 0.5
    circles = truth_of("circles", minutes=4.0)
    going = (circles.t > 40.0) & (circles.t < 220.0)
    assert np.min(circles.yaw_rate[going]) > 0.15
    assert np.std(circles.acceleration[going]) < 0.3


def test_launches_pause_while_shifting_gear():
    def weakest(shifts):
        drive = driven("straight_only", 5, 20.0, gear_shifts=shifts)
        crossing = np.flatnonzero((drive.speed[:-1] < 8.56) & (drive.speed[1:] >= 8.56))
        launches = [k for k in crossing if drive.speed[k + 100] > 9.3]
        assert len(launches) > 5
        return np.median([drive.acceleration[k - 25 : k + 25].min() for k in launches])

    assert weakest(True) < 0.45
    assert weakest(False) > 0.7


@pytest.mark.parametrize("seed", [1, 2])
def test_slopes_have_the_asked_rms_and_mean(seed):
    distance = np.linspace(0.0, 60_000.0, 200_000)
    road = Road(grade_mean=0.01)
    for side, sign in (("right", 1.0), ("left", -1.0)):
        found = road_attitude(
            road, DriveRoute(driving_side=side), seed, distance, np.zeros(200_000), 100.0
        )
        grade, fall = -np.tan(found.pitch), np.tan(found.roll)
        assert np.std(grade) == pytest.approx(0.02, rel=0.1)
        assert np.mean(grade) == pytest.approx(0.01, abs=0.003)
        assert np.std(fall) == pytest.approx(0.015, rel=0.1)
        assert np.mean(fall) == pytest.approx(sign * 0.012, abs=0.003)
        half = np.corrcoef(grade[:-367], grade[367:])[0, 1]
        # 110 m on: (1 + 1) / e of a second-order Gauss-Markov process.
        assert half == pytest.approx(2.0 / np.e, abs=0.06)


def test_banked_curves_take_their_share_of_the_lateral_force():
    level = {"road__bank_rms": 0.0, "road__crown_mean": 0.0}
    truth = truth_of("motorway", 3, 12.0, **level, road__superelevation=0.4)
    fast = truth.speed > 24.0
    lateral = (truth.speed * truth.yaw_rate)[fast]
    slope = np.polyfit(lateral, 9.80665 * np.sin(truth.road_roll[fast]), 1)[0]
    assert -0.45 < slope < -0.2


def test_a_smooth_road_gives_no_blows():
    """Whatever the route does, the force at a distant sensor changes as vehicles can change it."""
    quiet = {"road__roughness": False, "mount__lever_arm_m": (1.5, 0.6, 0.8)}
    for kind, seed in (("motorway", 3), ("mixed", 5), ("mixed", 6), ("city", 7)):
        truth = truth_of(kind, seed, 6.0, **quiet)
        jerk = np.diff(truth.force, axis=0) * 100.0
        assert np.max(np.abs(jerk)) < 25.0


def test_body_vibration_has_the_spectrum_of_a_quarter_car_on_an_iso_road():
    """Compared with the closed form of the transfer function, at constant speed."""
    rate, speed, n0 = 200.0, 15.0, 64e-6
    n = int(600 * rate)
    v = np.full(n, speed)
    suspension, chassis = Suspension(), Chassis()
    shaken = road_roughness(
        Road(roughness_n0=n0), chassis, suspension, 1, v, np.arange(n) * speed / rate, rate
    )
    assert shaken is not None
    f, p = welch(shaken.heave_acceleration, rate, nperseg=2048)
    s = 2j * np.pi * f
    ms, mu = 1.0, suspension.unsprung_ratio
    k = (2.0 * np.pi * suspension.heave_frequency_hz) ** 2
    c = 2.0 * suspension.heave_damping * np.sqrt(k)
    kt = mu * ((2.0 * np.pi * suspension.wheel_hop_hz) ** 2 - k / mu)
    # Two masses by Cramer's rule.
    a11, a12 = ms * s**2 + c * s + k, -(c * s + k)
    a22 = mu * s**2 + c * s + k + kt
    body = -a12 * kt / (a11 * a22 - a12**2)
    # The road is smoother where one drives faster: half the density at 15 m/s.
    density = n0 / 2.0 * 0.01 * (2.0 * np.pi) ** 2 * speed
    # Two independent tracks average; front and rear follow one another.
    tracks = 0.5 * np.abs(0.5 * (1.0 + np.exp(-s * chassis.wheelbase_m / speed))) ** 2
    expected = np.abs(body * s) ** 2 * density * tracks
    band = (f > 0.8) & (f < 15.0) & (tracks > 0.1)
    assert np.median(p[band] / expected[band]) == pytest.approx(1.0, abs=0.1)
    strong = band & (expected > 0.3 * expected[band].max())
    np.testing.assert_allclose(p[strong], expected[strong], rtol=0.45)


def test_rough_roads_shake_more_and_standing_is_quiet():
    def shake(n0):
        changes = {"road.roughness_n0": n0, "accel.vibration": False}
        drive = simulate(VehicleModel().with_changes(changes), 5, 3.0)
        series, truth = drive.samples["accel"], drive.truth
        speed = np.interp(series.t, truth.t, truth.speed)
        quick = np.diff(series.values[:, 2])
        return np.std(quick[speed[1:] > 5.0]), np.std(quick[speed[1:] == 0.0])

    (smooth, still), (rough, _) = shake(16e-6), shake(256e-6)
    assert rough > 2.0 * smooth
    assert still < smooth
