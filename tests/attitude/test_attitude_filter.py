"""Methods B and C together on motions whose attitude is known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucald.attitude.compensated import CompensatedAttitude
from imucald.attitude.estimate import AttitudeState
from imucald.attitude.filter import AttitudeFilter
from imucald.attitude.sensor_check import CheckResult
from imucald.config.attitude import AttitudeSettings, FilterSettings, MotionCompensationSettings
from imucald.core.rotations import rotation_from_angles

G = 9.80665
RATE = 50.0
DEG = math.pi / 180.0


def settings(compensation=None, grade_time=1.0, **of_filter) -> AttitudeSettings:
    return AttitudeSettings(
        grade_time=grade_time,
        compensation=MotionCompensationSettings(**(compensation or {})),
        filter=FilterSettings(**of_filter),
    )


class Motion:
    """A vehicle as a rigid body: R_earth_from_vehicle and speed as functions of time.

    Samples by numbers: rate from successive attitudes, force from successive velocities along the
    vehicle's x axis, all in vehicle axes (x forward, y left, z up; earth north, west, up).
    """

    def __init__(self, attitude, speed, seconds, seed=0):
        self.t = np.arange(0.0, seconds, 1.0 / RATE)
        h = 1e-4
        R, ahead = attitude(self.t), attitude(self.t + h)
        self.R = R
        turn = (R.inv() * ahead).as_rotvec() / h
        forward = [1.0, 0.0, 0.0]
        v0 = R.apply(forward) * speed(self.t)[:, None]
        v1 = ahead.apply(forward) * speed(self.t + h)[:, None]
        force = R.inv().apply((v1 - v0) / h + [0.0, 0.0, G])
        rng = np.random.default_rng(seed)
        self.gyro = turn + rng.normal(0.0, 0.0005, turn.shape)
        self.accel = force + rng.normal(0.0, 0.03, force.shape)
        self.v = speed(self.t)

    def feed(self, attitude, gyro_bias=(0.0, 0.0, 0.0), speed_every=5, until=None, extra=None):
        """Give all samples; returns the estimates at each."""
        found = []
        gyro = self.gyro + np.array(gyro_bias)
        for i, t in enumerate(self.t.tolist()):
            if until is not None and t > until:
                break
            if speed_every and i % speed_every == 0:
                attitude.reverse(self.v[i] < 0.0)
                attitude.speed(t, abs(float(self.v[i])))
            attitude.gyro(t, gyro[i].tolist())
            if extra is not None:
                extra(attitude, i, t)
            attitude.accel(t, self.accel[i].tolist())
            found.append(attitude.estimate(t) if attitude.running else None)
        return found

    def angles(self, i):
        R = self.R[i].as_matrix()
        return math.atan2(R[2, 1], R[2, 2]), -math.asin(R[2, 0])


def lying(roll=0.0, pitch=0.0, yaw=0.0):
    def attitude(t):
        return Rotation.from_euler("ZYX", np.tile([yaw, pitch, roll], (len(t), 1)))

    return attitude


def standing(t):
    return np.zeros(len(t))


def hilly(t):
    """Bends both ways, grades and banks, after ten seconds without a turn."""
    t = np.clip(t - 12.0, 0.0, None)
    t = t * t / (t + 4.0)
    yaw = 0.8 * np.sin(0.11 * t) + 0.02 * t
    pitch = 0.06 * np.sin(0.05 * t)
    roll = 0.04 * np.sin(0.07 * t + 1.0)
    return Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, roll]))


def driving(t):
    """Standing for ten seconds, then between 5 and 17 m/s."""
    moving = np.clip(t - 10.0, 0.0, None)
    return np.where(t < 10.0, 0.0, 11.0 - 11.0 * np.exp(-moving / 4.0) + 6.0 * np.sin(0.2 * moving)
                    * (1.0 - np.exp(-moving / 10.0)))  # fmt: skip


def test_it_starts_after_five_seconds_of_rest():
    motion = Motion(lying(0.05, -0.08), standing, 8.0)
    attitude = AttitudeFilter(settings())
    found = motion.feed(attitude)
    began = next(i for i, e in enumerate(found) if e is not None)
    assert 5.0 <= motion.t[began] < 6.3
    e = found[-1]
    assert e.state is AttitudeState.RELATIVE_HEADING
    assert (e.roll, e.pitch) == pytest.approx((0.05, -0.08), abs=0.1 * DEG)
    assert math.remainder(e.heading, 2.0 * math.pi) == pytest.approx(0.0, abs=0.1 * DEG)


def test_it_starts_in_motion_too():
    motion = Motion(hilly, lambda t: driving(t + 20.0), 30.0)
    found = motion.feed(AttitudeFilter(settings()))
    assert found[-1] is not None
    assert (found[-1].roll, found[-1].pitch) == pytest.approx(motion.angles(-1), abs=0.5 * DEG)


def settled_errors(motion, found):
    """Errors and deviations (N, 2) of roll and pitch from 30 s on, twice a second."""
    errors, stds = [], []
    for i in range(int(30 * RATE), len(found), 25):
        roll, pitch = motion.angles(i)
        errors.append((found[i].roll - roll, found[i].pitch - pitch))
        stds.append(found[i].std[:2])
    return np.array(errors), np.array(stds)


def test_driving_is_followed_within_its_own_deviation():
    motion = Motion(hilly, driving, 240.0)
    bias = (0.3 * DEG, -0.4 * DEG, 0.5 * DEG)
    found = motion.feed(AttitudeFilter(settings()), bias)
    errors, stds = settled_errors(motion, found)
    assert np.sqrt((errors**2).mean(axis=0)).max() < 0.1 * DEG
    assert np.mean(np.abs(errors) < 1.96 * stds) > 0.9
    assert found[-1].bias == pytest.approx(bias, abs=0.02 * DEG)
    assert found[-1].rate == pytest.approx(motion.gyro[-1], abs=0.02 * DEG)


def test_grade_is_that_of_the_road():
    motion = Motion(lying(pitch=-math.atan(0.08)), driving, 60.0)
    e = motion.feed(AttitudeFilter(settings()))[-1]
    assert e.grade == pytest.approx(0.08, abs=0.004)
    assert e.grade_std > 0.0


@pytest.mark.parametrize("speed_every", [5, 50])
def test_it_updates_at_its_interval_whatever_the_rate_of_the_speed(speed_every, monkeypatch):
    """Method C, each sampling period; the truth is the rigid body's."""
    motion = Motion(hilly, driving, 120.0)
    bias = (0.3 * DEG, -0.4 * DEG, 0.5 * DEG)
    attitude = AttitudeFilter(settings({"interval": 1.0 / RATE}))
    newest: list[float] = []
    take = attitude.kalman.update

    def update(measurements):
        newest.append(attitude._propagator.t)
        return take(measurements)

    monkeypatch.setattr(attitude.kalman, "update", update)
    found = motion.feed(attitude, bias, speed_every)
    times = np.unique([t for t in newest if t > 10.0])
    assert np.diff(times).max() == pytest.approx(1.0 / RATE, abs=1e-6)
    errors, stds = settled_errors(motion, found)
    assert np.sqrt((errors**2).mean(axis=0)).max() < 0.15 * DEG
    assert np.mean(np.abs(errors) < 1.96 * stds) > 0.9


def test_reversing_is_the_other_way_round():
    speed = lambda t: -0.4 * np.clip(t - 10.0, 0.0, 8.0)  # noqa: E731
    e = Motion(lying(pitch=0.05), speed, 17.0).feed(AttitudeFilter(settings()))[-1]
    assert e.pitch == pytest.approx(0.05, abs=0.3 * DEG)


def test_a_late_slow_speed_does_no_harm():
    """Once a second and 0.4 s late: the interval is moved, the attitude goes on by gyroscope."""
    motion = Motion(hilly, driving, 120.0)
    late = Motion(hilly, lambda t: driving(t - 0.4), 120.0)
    motion.v = late.v
    attitude = AttitudeFilter(settings({"delay": 0.4}))
    found = motion.feed(attitude, speed_every=50)
    errors = [np.subtract((found[i].roll, found[i].pitch), motion.angles(i))
              for i in range(2000, len(found), 50)]  # fmt: skip
    assert np.sqrt(np.mean(np.square(errors), axis=0)).max() < 0.15 * DEG


def test_a_lever_arm_is_allowed_for():
    arm = np.array([1.5, 0.3, 0.4])
    motion = Motion(hilly, driving, 90.0)
    h = 1e-4
    R0, R1 = hilly(motion.t), hilly(motion.t + h)
    R2 = hilly(motion.t + 2 * h)
    swing = (R2.apply(arm) - 2 * R1.apply(arm) + R0.apply(arm)) / h**2
    motion.accel = motion.accel + R0.inv().apply(swing)
    with_arm = AttitudeFilter(settings({"lever_arm": tuple(arm)}))
    found = motion.feed(with_arm)
    errors = [np.subtract((found[i].roll, found[i].pitch), motion.angles(i))
              for i in range(1500, len(found), 50)]  # fmt: skip
    assert np.sqrt(np.mean(np.square(errors), axis=0)).max() < 0.1 * DEG


def test_speed_over_the_map_is_turned_along_the_slope():
    slope = 0.2
    along = lambda t: np.clip(t - 10.0, 0.0, 12.0) * 3.0  # noqa: E731
    motion = Motion(lying(pitch=-slope), along, 21.0)
    motion.v = motion.v * math.cos(slope)
    errors = {}
    for kind in ("horizontal", "along_road"):
        e = motion.feed(AttitudeFilter(settings({"speed_is": kind})))[-1]
        errors[kind] = abs(e.pitch + slope)
    assert errors["horizontal"] < 0.1 * DEG
    assert errors["along_road"] > errors["horizontal"]


def test_a_turntable_is_no_zero_error():
    """Speed says zero, the vehicle turns by 6 deg/s (a ferry, a lift, a dead band)."""
    motion = Motion(lambda t: Rotation.from_euler("Z", 0.1 * t[:, None]), standing, 50.0)
    attitude = AttitudeFilter(settings())
    e = motion.feed(attitude)[-1]
    assert not attitude.checked
    assert e.bias == pytest.approx((0.0, 0.0, 0.0), abs=0.05 * DEG)


def test_without_speed_the_noise_is_widened():
    """A long bend: the force leans; without speed the filter hardly follows, and says so."""
    yaw = lambda t: 0.25 * np.clip(t - 20.0, 0.0, None)  # noqa: E731

    def bend(t):
        return Rotation.from_euler("Z", yaw(t)[:, None])

    motion = Motion(bend, lambda t: np.full(len(t), 12.0), 50.0)
    motion.v = np.where(motion.t < 20.0, 12.0, np.nan)
    attitude = AttitudeFilter(settings({"timeout": 1.5}))

    for i, t in enumerate(motion.t.tolist()):
        if i % 5 == 0 and t < 20.0:
            attitude.speed(t, 12.0)
        attitude.gyro(t, motion.gyro[i].tolist())
        attitude.accel(t, motion.accel[i].tolist())
    e = attitude.estimate()
    leaning = math.atan2(12.0 * 0.25, G)  # 17 deg: what the accelerometer says
    assert abs(e.roll) < 0.1 * leaning
    assert abs(e.roll) < 3.0 * e.std[0] + 0.3 * DEG


def test_the_sensor_check_is_made_once_after_thirty_seconds():
    motion = Motion(lying(0.02, 0.01), standing, 60.0)
    motion.accel = motion.accel * (1.0 + 0.15 / G)
    attitude = AttitudeFilter(settings())
    motion.feed(attitude, (0.01, -0.02, 0.03), until=29.0)
    assert not attitude.checked
    attitude = AttitudeFilter(settings())
    motion.feed(attitude, (0.01, -0.02, 0.03))
    assert attitude.checked
    right, forward, up = attitude.constant_bias
    assert (forward, -right, up) == pytest.approx((0.01, -0.02, 0.03), abs=2e-4)
    size = math.hypot(*attitude.constant_accel_error)
    assert size == pytest.approx(0.15, abs=0.01)
    attitude.check_again()
    assert not attitude.checked


def test_a_rest_that_no_sound_accelerometer_has_ends_nothing_and_is_judged_again():
    """4.7 and 5.0 m/s^2 by turns of half a second: no two hops in a row that health would name."""
    motion = Motion(lying(), standing, 110.0)
    sound = motion.accel.copy()
    motion.accel[:, 2] += np.where(np.floor(motion.t * 2.0) % 2.0, 4.7, 5.0) - G
    attitude = AttitudeFilter(settings())
    motion.feed(attitude, until=70.0)
    assert attitude.running
    assert not attitude.checked
    assert attitude.constant_accel_error == (0.0, 0.0, 0.0)
    motion.accel = sound
    for i in np.flatnonzero(motion.t > 70.0).tolist():
        t = float(motion.t[i])
        attitude.speed(t, 0.0)
        attitude.gyro(t, motion.gyro[i].tolist())
        attitude.accel(t, motion.accel[i].tolist())
    assert attitude.checked
    assert attitude.constant_accel_error == pytest.approx((0.0, 0.0, 0.0), abs=0.02)


def test_a_check_on_level_ground_takes_the_whole_mean():
    motion = Motion(lying(0.02, 0.0), standing, 45.0)
    attitude = AttitudeFilter(settings(check_level=True))
    motion.feed(attitude)
    right, forward, _ = attitude.constant_accel_error
    assert (-right, forward) == pytest.approx((G * math.sin(0.02), 0.0), abs=0.01)


@pytest.mark.parametrize("bias", [-0.5, 0.15, 0.5])
def test_a_zero_error_that_no_rest_shows_is_no_tilt_on_the_motorway(bias):
    """It seems to take off v b to the side, and what slopes bring to light would feed back."""
    motion = Motion(hilly, lambda t: np.full(len(t), 30.0), 300.0)
    attitude = AttitudeFilter(settings())
    found = motion.feed(attitude, (0.1 * DEG, 0.1 * DEG, bias * DEG))
    for i in range(3000, len(found), 50):
        e, (roll, pitch) = found[i], motion.angles(i)
        assert abs(e.roll - roll) < 3.0 * e.std[0] + 0.2 * DEG
        assert abs(e.pitch - pitch) < 3.0 * e.std[1] + 0.2 * DEG
        assert abs(e.bias[2] - bias * DEG) < 3.0 * e.rate_std[2]


@pytest.mark.parametrize("off", [0.0, 0.1, 0.4])
def test_the_check_of_an_earlier_drive_is_a_first_guess(off):
    """The gyroscope has been off since, and cold."""
    motion = Motion(hilly, lambda t: np.full(len(t), 15.0), 150.0)
    attitude = AttitudeFilter(settings())
    attitude.restore_check(CheckResult((0.0, 0.0, 0.2 * DEG), (0.0, 0.0, 0.0)))
    e = motion.feed(attitude, (0.0, 0.0, (0.2 + off) * DEG))[-1]
    yaw = motion.R[-1].as_euler("ZYX")[0] - motion.R[250].as_euler("ZYX")[0]
    assert abs(math.remainder(e.heading + yaw, 2.0 * math.pi)) < 3.0 * e.std[2] + 1.0 * DEG


@pytest.mark.parametrize("gain", [0.98, 1.01])
def test_a_wrong_gain_is_wrong_in_all_turns_of_a_car_park(gain):
    def spiral(t):
        yaw = 0.4 * np.clip(t - 10.0, 0.0, 120.0)
        return Rotation.from_euler("ZYX", np.column_stack([yaw, 0.0 * t, 0.0 * t]))

    motion = Motion(spiral, lambda t: np.where(t < 10.0, 0.0, 3.0), 150.0)
    motion.gyro *= gain
    found = motion.feed(AttitudeFilter(settings()))
    yaw = motion.R.as_euler("ZYX")[:, 0]
    for i in range(600, len(found), 50):
        e = found[i]
        error = math.remainder(e.heading + yaw[i], 2.0 * math.pi)
        assert abs(error) < 3.0 * e.std[2] + 0.5 * DEG


@pytest.mark.parametrize("when", ["it stops", "it drives off"])
def test_a_vehicle_that_rolls_while_its_speed_says_zero_spoils_no_zero_error(when):
    """A turn of 0.7 deg/s in the first 1.5 s or the last 0.8 s of every rest of ten seconds."""
    motion = Motion(lying(), lambda t: np.where(np.mod(t, 20.0) < 10.0, 1.0, 0.0), 120.0)
    motion.accel[:, 0] = np.random.default_rng(1).normal(0.0, 0.03, len(motion.t))
    into = np.mod(motion.t, 20.0) - 10.0
    rolls = (into > 0.0) & (into < 1.5) if when == "it stops" else into > 9.2
    motion.gyro[rolls, 2] += 0.7 * DEG
    e = motion.feed(AttitudeFilter(settings()), (0.0, 0.0, 0.3 * DEG))[-1]
    assert e.bias[2] == pytest.approx(0.3 * DEG, abs=0.03 * DEG)


def test_heading_follows_a_signal():
    motion = Motion(lying(), standing, 20.0)

    def heading(attitude, i, t):
        if i % 10 == 0:
            attitude.heading(t, 2.0 + 0.02 * math.sin(i))

    e = motion.feed(AttitudeFilter(settings(heading="signal")), extra=heading)[-1]
    assert e.state is AttitudeState.FULL
    assert e.heading == pytest.approx(2.0, abs=1.0 * DEG)
    assert 2.0 * DEG <= e.std[2] < 3.0 * DEG, "its own error is not averaged away"


def test_heading_follows_the_magnetometer_on_a_slope():
    yaw = -math.radians(70.0)  # 70 deg clockwise from north
    motion = Motion(lying(0.1, -0.15, yaw), standing, 25.0)
    field = motion.R[0].inv().apply([20e-6, 0.0, -45e-6])  # north, west, up
    declination = math.radians(3.0)

    def mag(attitude, i, t):
        attitude.mag(t, field.tolist())

    use = settings(heading="magnetometer", declination_deg=math.degrees(declination))
    e = motion.feed(AttitudeFilter(use), extra=mag)[-1]
    assert e.heading == pytest.approx(math.radians(73.0), abs=0.5 * DEG)


def test_a_better_mount_turns_the_vehicle_not_the_sensor():
    motion = Motion(lying(0.05, -0.08), standing, 20.0)
    old = rotation_from_angles(0.0, 0.0, 0.0)
    new = rotation_from_angles(0.03, -0.02, 0.4)
    attitude = AttitudeFilter(settings())
    motion.feed(attitude, (0.01, 0.0, 0.0))
    before = attitude.kalman.P.copy()
    attitude.turned(old.ravel().tolist(), new.ravel().tolist())
    e = attitude.estimate()
    R = motion.R[0].as_matrix() @ old @ new.T  # of the new vehicle axes
    expected = math.atan2(R[2, 1], R[2, 2]), -math.asin(R[2, 0])
    assert (e.roll, e.pitch) == pytest.approx(expected, abs=0.2 * DEG)
    assert e.bias == pytest.approx(new @ old.T @ [0.01, 0.0, 0.0], abs=0.01 * DEG)
    assert np.trace(attitude.kalman.P) == pytest.approx(np.trace(before))


def test_silence_is_not_available_and_a_gap_starts_anew():
    motion = Motion(lying(), standing, 10.0)
    attitude = AttitudeFilter(settings())
    motion.feed(attitude)
    assert attitude.estimate(10.4).state is AttitudeState.RELATIVE_HEADING
    before, late = attitude.estimate(10.4), attitude.estimate(10.5)
    assert late.state is AttitudeState.SETTLING, "what turned since the last sample is not known"
    assert min(np.subtract(late.std, before.std)) > 5.0 * DEG
    assert math.isnan(late.rate[0])
    assert attitude.estimate(11.5).state is AttitudeState.NOT_AVAILABLE
    attitude.reset()
    assert not attitude.running


def bend_on_a_ramp(t):
    """After forty seconds level and straight: 20 deg/s to the left, and a ramp of 6 deg at once."""
    yaw = 20.0 * DEG * np.clip(t - 40.0, 0.0, 25.0)
    pitch = -3.0 * DEG * np.clip(t - 50.2, 0.0, 2.0)
    return Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, np.zeros(len(t))]))


def feed_broken(attitude, silent=0.0, all_silent=0.0, back=0.0, heading=False):
    """The bend on a ramp; at 50 s something is silent, or the clock is set back [s].

    Returns times, estimates, and errors of pitch and heading.
    """
    motion = Motion(bend_on_a_ramp, lambda t: 0.5 * np.clip(t - 10.0, 0.0, 20.0), 90.0)
    yaw = motion.R.as_euler("ZYX")[:, 0]
    rng = np.random.default_rng(3)
    found, stream = [], 0.0
    for i, t in enumerate(motion.t.tolist()):
        stream = max(stream, t - back if t >= 50.0 else t)  # as `runtime.timebase` has it
        if 50.0 <= t < 50.0 + all_silent:
            continue
        if i % 5 == 0:
            attitude.speed(stream, float(motion.v[i]))
        if not 50.0 <= t < 50.0 + silent:
            attitude.gyro(stream, motion.gyro[i].tolist())
        attitude.accel(stream, motion.accel[i].tolist())
        if heading and i % 25 == 0:
            attitude.heading(stream, float(-yaw[i] + rng.normal(0.0, 1.0 * DEG)))
        e = attitude.estimate(stream)
        pitch = e.pitch - motion.angles(i)[1]
        found.append((t, e, pitch, math.remainder(e.heading + yaw[i], 2.0 * math.pi)))
    return found


BROKEN = [{"silent": s} for s in (0.6, 0.9, 1.5, 3.0, 8.0)] + [
    {"all_silent": 0.7}, {"all_silent": 8.0}, {"back": 0.2}, {"back": 0.9}
]  # fmt: skip


@pytest.mark.parametrize("broken", BROKEN)
@pytest.mark.parametrize("heading", ["free", "signal"])
def test_what_nobody_saw_turn_is_never_called_good(broken, heading):
    """What is called good is so within its deviation, at every sample after a silence."""
    attitude = AttitudeFilter(settings(heading=heading))
    found = feed_broken(attitude, **broken, heading=heading == "signal")
    good = {AttitudeState.RELATIVE_HEADING, AttitudeState.FULL}
    longest = max(broken.values())
    began = AttitudeState.FULL if heading == "signal" else AttitudeState.RELATIVE_HEADING
    assert next(e.state for t, e, _, _ in reversed(found) if t < 50.0) is began
    dropped = False
    for t, e, pitch, yaw in found:
        if e.state in good and 50.0 <= t < 50.5:
            continue  # an old angle is called good no longer than the longest step
        if e.state in good:
            assert abs(pitch) < 4.0 * e.std[1] + 0.3 * DEG, t
        if e.state is AttitudeState.FULL:
            assert abs(yaw) < 4.0 * e.std[2] + 0.3 * DEG, t
        if e.state is AttitudeState.RELATIVE_HEADING and heading == "free" and longest < 1.0:
            assert abs(yaw) < 4.0 * e.std[2] + 0.3 * DEG, t  # it goes on from the same start
        if t > 50.0 + longest:
            dropped |= e.state not in good
            assert dropped, "the first sample after it says so"
        elif t > 50.6 and not broken.get("back"):
            assert e.state not in good
    t, e, pitch, _ = found[-1]
    assert e.state is began, "it comes back"
    assert abs(pitch) < 0.3 * DEG
    recovered = max(t for t, e, _, _ in found if e.state not in good)
    assert recovered < 50.0 + longest + 8.0


def swerve(t):
    """Straight; at 50 s to the left and straight on: the rate grows and falls by 2 rad/s^2."""
    x = np.clip(t - 50.02, 0.0, 0.4)
    yaw = np.where(x < 0.2, x * x, 0.08 - (0.4 - x) ** 2)
    return Rotation.from_euler("ZYX", np.column_stack([yaw, 0.0 * t, 0.0 * t]))


@pytest.mark.parametrize("silent", [0.15, 0.25, 0.4, 0.45])
def test_what_turned_between_two_samples_far_apart_is_in_the_deviation(silent):
    motion = Motion(swerve, lambda t: 0.5 * np.clip(t - 10.0, 0.0, 20.0), 60.0)
    attitude = AttitudeFilter(settings())
    for i, t in enumerate(motion.t.tolist()):
        if i % 5 == 0:
            attitude.speed(t, float(motion.v[i]))
        if not 50.0 < t < 50.0 + silent:
            attitude.gyro(t, motion.gyro[i].tolist())
        attitude.accel(t, motion.accel[i].tolist())
    yaw = motion.R.as_euler("ZYX")[:, 0]
    e = attitude.estimate(float(motion.t[-1]))
    assert e.state is AttitudeState.RELATIVE_HEADING
    assert abs(math.remainder(e.heading + yaw[-1], 2.0 * math.pi)) < 3.0 * e.std[2] + 0.3 * DEG
    assert e.std[2] < 6.0 * DEG


def test_samples_in_batches_are_no_gaps():
    motion = Motion(lying(), standing, 20.0)
    attitude, in_batches = AttitudeFilter(settings()), AttitudeFilter(settings())
    for one, n in ((attitude, 1), (in_batches, 12)):
        for i, t in enumerate(motion.t.tolist()):
            stamp = float(motion.t[i - i % n])  # of 12 samples at once, every 0.24 s
            one.gyro(stamp, motion.gyro[i].tolist())
            one.accel(stamp, motion.accel[i].tolist())
            if i % 25 == 0:
                one.speed(t, 0.0)
    a, b = attitude.estimate(), in_batches.estimate()
    assert b.std[2] < 1.5 * a.std[2] + 0.1 * DEG


@pytest.mark.parametrize("silent", [0.7, 2.5])
def test_the_grade_of_a_ramp_that_nobody_saw_is_not_called_good(silent):
    found = feed_broken(AttitudeFilter(settings(grade_time=10.0)), silent=silent)
    for t, e, _, _ in found:
        if e.state is AttitudeState.RELATIVE_HEADING and t > 54.0 and not math.isnan(e.grade):
            error = math.atan(e.grade) - 6.0 * DEG
            assert abs(error) < 3.0 * math.atan(e.grade_std), t
    assert not math.isnan(found[-1][1].grade)


def test_a_start_anew_claims_no_better_gyroscope_than_before():
    """Its zero error walked unseen for an hour; that is forgotten at the next rest only."""
    filter_ = AttitudeFilter().kalman
    filter_.start(0.1, 0.0, 1e-4)
    for _ in range(3600):
        filter_.predict((1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), 1.0, 0.0)
    walked = filter_.P[5, 5]
    assert walked > 4e-8
    filter_.start(0.1, 0.0, 1e-4)
    assert filter_.P[5, 5] == walked


def test_method_b_carries_no_vertical_over_a_clock_that_was_set_back():
    """A slope that comes while time stands still: the force says it at once, not after 10 s."""
    attitude = CompensatedAttitude(settings({"rate_time": 10.0}))
    stream = 0.0
    for i in range(3000):
        t = i / RATE
        stream = max(stream, t - 0.9 if t >= 50.0 else t)
        slope = 12.0 * DEG * min(max((t - 50.0) / 0.8, 0.0), 1.0)
        rate = 15.0 * DEG if 50.0 < t < 50.8 else 0.0
        attitude.gyro(stream, (rate, 0.0, 0.0))
        attitude.accel(stream, (0.0, G * math.sin(slope), G * math.cos(slope)))
    for _ in range(10):
        stream += 1.0 / RATE
        attitude.gyro(stream, (0.0, 0.0, 0.0))
        attitude.accel(stream, (0.0, G * math.sin(12.0 * DEG), G * math.cos(12.0 * DEG)))
    assert attitude.estimate(stream).roll == pytest.approx(12.0 * DEG, abs=0.5 * DEG)


def test_no_gravity_is_not_levelled_by():
    attitude = AttitudeFilter(settings())
    for k in range(600):
        t = k / RATE
        attitude.speed(t, 0.0)
        attitude.gyro(t, (0.0, 0.0, 0.0))
        attitude.accel(t, (0.0, 0.0, 0.0))
    assert not attitude.running


def test_method_b_alone_has_the_same_verbs():
    motion = Motion(lying(0.03, -0.05), driving, 60.0)
    found = motion.feed(CompensatedAttitude(settings()))
    e = found[-1]
    assert e.state is AttitudeState.UNFILTERED
    assert (e.roll, e.pitch) == pytest.approx((0.03, -0.05), abs=1.5 * DEG)
    assert math.isnan(e.heading)


def test_method_b_alone_finds_the_zero_error_at_rest():
    motion = Motion(lying(), standing, 40.0)
    attitude = CompensatedAttitude(settings())
    e = motion.feed(attitude, (0.01, -0.02, 0.03))[-1]
    assert attitude.checked
    assert e.bias == pytest.approx((0.01, -0.02, 0.03), abs=2e-4)


@pytest.mark.slow
def test_a_day_of_stops_and_drives():
    """Twenty-four hours at one sample a second: no blow-up, angles where they were."""
    attitude = AttitudeFilter(settings({"interval": 4.0, "average": 0.5}, longest_step=2.0))
    rng = np.random.default_rng(9)
    n = 86_400
    gyro = rng.normal((0.002, -0.001, 0.001), 2e-4, (n, 3))
    accel = rng.normal(0.0, 0.02, (n, 3))
    for t in range(n):
        drives = t % 1200 > 300
        attitude.speed(float(t), 15.0 if drives else 0.0)
        attitude.gyro(float(t), gyro[t].tolist())
        x, y, z = accel[t].tolist()
        attitude.accel(float(t), (x - G * math.sin(0.02), y, z + G * math.cos(0.02)))
    e = attitude.estimate()
    assert (e.roll, e.pitch) == pytest.approx((0.0, 0.02), abs=0.2 * DEG)
    assert max(e.std[:2]) < 0.7 * DEG
    assert e.bias == pytest.approx((0.002, -0.001, 0.001), abs=0.03 * DEG)
    P = attitude.kalman.P
    assert np.array_equal(P, P.T)
    assert np.linalg.eigvalsh(P).min() > 0.0
    assert sum(c * c for c in attitude._propagator.q) == pytest.approx(1.0, abs=1e-12)
