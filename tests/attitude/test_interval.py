"""Method B over intervals: the telescoped velocity is B's integral, and doubt widens the noise."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucald.attitude.endpoints import EndpointMaker
from imucald.attitude.grade import GradeFilter
from imucald.attitude.interval import Endpoint, along_body, interval
from imucald.attitude.propagation import HISTORY_S, Propagator
from imucald.config.attitude import MotionCompensationSettings

G = 9.80665
RATE = 200.0
PLAIN = MotionCompensationSettings()


def travelled(seconds=3.0, lever=(0.0, 0.0, 0.0), speed=lambda t: 10.0 + 1.5 * t):
    """A body (x right, y forward, z up) that turns about all axes, fed to a propagator."""
    t = np.arange(0.0, seconds, 1.0 / RATE)
    h = 1e-5

    def attitude(s):
        angles = [0.05 * np.sin(s), 0.1 * np.sin(2 * s), 0.3 * s]
        return Rotation.from_euler("ZXY", np.column_stack([angles[2], angles[0], angles[1]]))

    R, ahead = attitude(t), attitude(t + h)
    rate = (R.inv() * ahead).as_rotvec() / h
    v0 = R.apply([0, 1, 0]) * speed(t)[:, None]
    v1 = ahead.apply([0, 1, 0]) * speed(t + h)[:, None]
    force = R.inv().apply((v1 - v0) / h + [0, 0, G])
    propagator = Propagator(0.5, lever)
    for i, s in enumerate(t.tolist()):
        propagator.gyro(s, tuple(rate[i]), (0.0, 0.0, 0.0))
        propagator.accel(s, tuple(force[i]))
    return propagator, t, R, rate, force, speed


def endpoint(propagator, t, speed):
    snapshot = propagator.at(t)
    assert snapshot is not None
    return Endpoint(snapshot, speed)


def test_the_gyroscope_carries_the_attitude():
    propagator, _, R, *_ = travelled()
    C = np.array(propagator.C).reshape(3, 3)
    start = R[0].as_matrix()
    assert start @ C == pytest.approx(R[-1].as_matrix(), abs=1e-5)


def test_an_interval_is_the_mean_of_bs_instants():
    """mean(C (f - a_fwd y - omega x v y)), instant by instant, against the telescoped form."""
    propagator, t, R, rate, force, speed = travelled()
    i, j = 100, 420
    found = interval(
        endpoint(propagator, t[i], float(speed(t[i]))),
        endpoint(propagator, t[j], float(speed(t[j]))),
        PLAIN, (0.02,) * 3, 1.0,
    )  # fmt: skip
    forward = np.array([0.0, 1.0, 0.0])
    left = []
    for k in range(i, j + 1):
        rest = force[k] - 1.5 * forward - np.cross(rate[k], speed(t[k]) * forward)
        left.append((R[0].inv() * R[k]).apply(rest))
    left = np.array(left)
    mean = (left[:-1] + left[1:]).mean(axis=0) / 2.0
    assert found.up == pytest.approx(mean, abs=2e-3)
    assert found.forward_acceleration == pytest.approx(1.5)
    up = R[0].inv().apply([0.0, 0.0, G])
    assert found.up == pytest.approx(up, abs=5e-3)


def test_a_lever_arm_moves_the_velocity():
    """C (omega x l): the velocity of the sensor's place against that of the vehicle's."""
    lever = (0.3, 1.0, 0.5)
    propagator, t, R, rate, *_ = travelled(lever=lever)
    expected = (R[0].inv() * R[200]).apply(np.cross(rate[200], lever))
    assert propagator.at(t[200]).arm == pytest.approx(expected, abs=0.01)


def test_integrals_between_samples_are_interpolated():
    propagator, t, *_ = travelled()
    a, m, b = (propagator.at(s) for s in (t[50], 0.5 * (t[50] + t[51]), t[51]))
    assert m.force == pytest.approx(np.add(a.force, b.force) / 2.0, abs=1e-12)
    assert propagator.at(t[-1] + 0.1) is None
    assert propagator.at(-1.0) is None


def test_history_is_bounded():
    propagator, t, *_ = travelled(seconds=HISTORY_S + 3.0)
    assert propagator.at(t[0]) is None
    assert propagator.at(t[-1] - HISTORY_S + 0.1) is not None


def test_accelerometer_samples_wait_for_the_gyroscope():
    """Force between two rates is carried by the attitude between; later ones wait."""
    propagator = Propagator(0.5, (0.0, 0.0, 0.0))
    propagator.gyro(0.0, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
    propagator.accel(0.0, (0.0, 1.0, G))
    propagator.accel(0.05, (0.0, 1.0, G))
    assert propagator.newest.t == 0.0
    propagator.gyro(0.1, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
    assert propagator.newest.t == 0.05
    angle = math.atan2(-propagator.newest.forward[0], propagator.newest.forward[1])
    assert angle == pytest.approx(0.05, abs=1e-4)


def test_a_hole_begins_a_new_segment():
    propagator, t, *_ = travelled(1.0)
    later = float(t[-1]) + 2.0
    propagator.gyro(later, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    propagator.accel(later, (0.0, 0.0, G))
    assert propagator.segment_start == later
    assert propagator.at(float(t[-1])) is None


# doubt -----------------------------------------------------------------------------------------


def sigmas(v0, v1, settings=PLAIN, **motion):
    propagator, t, *_ = travelled(**motion)
    found = interval(
        endpoint(propagator, t[100], v0),
        endpoint(propagator, t[300], v1),
        settings,
        (0.02,) * 3,
        1.0,
    )
    return found.sigma_forward, found.sigma_lateral


def test_acceleration_makes_unsure():
    calm, brisk = sigmas(20.0, 20.0), sigmas(20.0, 24.0)
    assert brisk[0] > calm[0] + 0.02


def test_creeping_makes_unsure():
    """The signal may still say zero: a dead band."""
    assert sigmas(0.0, 0.6)[0] > 3.0 * sigmas(5.0, 5.6)[0]


def test_without_speed_nothing_is_sure():
    forward, lateral = sigmas(10.0, math.nan)
    assert min(forward, lateral) >= 1.0


def test_a_lever_arm_that_is_not_known_makes_unsure():
    known = MotionCompensationSettings(lever_uncertainty=0.0)
    assert sigmas(10.0, 11.0)[1] > sigmas(10.0, 11.0, known)[1]


def test_a_horizontal_speed_is_longer_along_the_slope():
    propagator, t, *_ = travelled()
    k = endpoint(propagator, t[0], 10.0)
    up = (0.0, math.sin(0.2), math.cos(0.2))  # forward rises by 0.2 rad
    assert along_body(k, up).speed == pytest.approx(10.0 / math.cos(0.2))


# endpoints -----------------------------------------------------------------------------------


def endpoints_of(settings, speeds, seconds=6.0):
    propagator = Propagator(0.5, (0.0, 0.0, 0.0))
    maker = EndpointMaker(settings, propagator)
    pending = list(speeds)
    found = []
    for k in range(int(seconds * 50)):
        t = k / 50
        while pending and pending[0][0] <= t:
            maker.speed(*pending.pop(0))
        propagator.gyro(t, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        propagator.accel(t, (0.0, 0.0, G))
        found += list(maker.complete())
    return found


def test_intervals_are_a_second_at_least():
    found = endpoints_of(PLAIN, [(0.1 * k, 5.0) for k in range(60)])
    assert found[0][0] is None
    lengths = [b.snapshot.t - a.snapshot.t for a, b in found[1:]]
    assert len(lengths) >= 4
    assert min(lengths) == pytest.approx(1.0, abs=0.11)


def test_late_speed_meets_the_force_of_its_time():
    settings = MotionCompensationSettings(delay=0.4, average=0.01)
    found = endpoints_of(settings, [(1.0 * k, float(k)) for k in range(6)])
    assert [b.snapshot.t for _, b in found] == pytest.approx([0.6, 1.6, 2.6, 3.6, 4.6])
    assert [b.speed for _, b in found] == [1.0, 2.0, 3.0, 4.0, 5.0]


def test_leading_speed_waits():
    settings = MotionCompensationSettings(delay=-0.3, average=0.01)
    found = endpoints_of(settings, [(1.0 * k, float(k)) for k in range(6)])
    assert [b.snapshot.t for _, b in found] == pytest.approx([0.3, 1.3, 2.3, 3.3, 4.3, 5.3])


def test_without_speed_intervals_go_on_by_time():
    found = endpoints_of(MotionCompensationSettings(timeout=1.5), [(0.0, 3.0)], 8.0)
    unknown = [(a, b) for a, b in found if math.isnan(b.speed)]
    assert len(unknown) >= 5


def test_grade_is_less_what_the_springs_add():
    propagator, t, *_ = travelled()
    accelerating = interval(
        endpoint(propagator, t[100], 10.0),
        endpoint(propagator, t[300], 12.0),
        PLAIN,
        (0.02,) * 3,
        1.0,
    )
    grade = GradeFilter(0.005, 1.0)
    grade.take_interval(accelerating, 0.05)
    assert grade.grade == pytest.approx(math.tan(0.05 - 0.005 * 2.0))
