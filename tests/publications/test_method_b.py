"""Method B as the package has it against the claims, number by number."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucald.attitude.carried_angles import CarriedAngles, vertical
from imucald.attitude.compensated import CompensatedAttitude
from imucald.attitude.motion_compensation import MotionCompensation, deflection
from imucald.config.attitude import AttitudeSettings, MotionCompensationSettings
from publications import method_b as text
from publications.recordings import recording, table

G = text.G
UP = np.array([0.0, 0.0, G])
OPTIONS = {
    "presets": {},
    "plane": {"centripetal": "plane"},
    "over the map": {"speed_is": "horizontal"},
    "plane, over the map": {"centripetal": "plane", "speed_is": "horizontal"},
    "long average": {"average": 1.5},
    "short interval": {"interval": 0.05},
    "late speed": {"delay": 0.3},
    "short timeout": {"timeout": 0.25},
}


def same_settings(options):
    return text.Correction(
        average=options.get("average", 0.2),
        interval=options.get("interval", 1.0),
        timeout=options.get("timeout", 3.0),
        delay=options.get("delay", 0.0),
        plane=options.get("centripetal") == "plane",
        horizontal=options.get("speed_is") == "horizontal",
    )


def test_claims_2_and_3_the_deflection_at_any_lean() -> None:
    rng = np.random.default_rng(3)
    for _ in range(500):
        angle = float(rng.uniform(-math.pi, math.pi))
        a, s = (float(v) for v in rng.uniform(-9.0, 9.0, 2))
        off = deflection(angle, a, s) - text.deflection(angle, a, s)
        assert math.remainder(off, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-12)
    assert deflection(0.5 * math.pi, 2.0, 2.0) == pytest.approx(
        text.deflection(0.5 * math.pi, 2.0, 2.0), abs=1e-12
    )


@pytest.mark.parametrize("option", sorted(OPTIONS))
def test_claim_1_each_instant_of_random_motion(option: str) -> None:
    """B1 among it: the centripetal part is of the current speed, the forward one of the average."""
    rng = np.random.default_rng(len(option))
    options = OPTIONS[option]
    ours = MotionCompensation(MotionCompensationSettings(**options))
    theirs = same_settings(options)
    speed, t_speed = 10.0, 0.0
    for k in range(3000):
        t = 0.01 * k
        if t >= t_speed:
            speed = max(0.0, speed + float(rng.normal(0.0, 0.5)))
            t_speed = t + float(rng.uniform(0.05, 0.6))
            ours.speed(t, speed)
            theirs.speed(t, speed)
        f = tuple((rng.normal(0.0, 2.0, 3) + UP).tolist())
        w = tuple(rng.normal(0.0, 0.3, 3).tolist())
        found = ours.take_sample(t, f, w)
        force, rate, measured, corrected = theirs.take(t, f, w)
        assert found.force == pytest.approx(tuple(force), abs=1e-9)
        assert found.rate == pytest.approx(tuple(rate), abs=1e-12)
        assert (found.raw_pitch, found.raw_roll) == pytest.approx(measured, abs=1e-9)
        apart = math.hypot(
            math.remainder(found.pitch - corrected[0], 2.0 * math.pi),
            math.remainder(found.roll - corrected[1], 2.0 * math.pi),
        )
        assert apart < 1e-9


def alone(**options: object) -> CompensatedAttitude:
    return CompensatedAttitude(AttitudeSettings(compensation=MotionCompensationSettings(**options)))


def braking_turn(rate_hz: float) -> float:
    """Largest roll of B alone on a level road, braking by 4 m/s2 while turning by 0.3 rad/s [deg].

    Samples at 100 Hz, speed at rate_hz; nothing is wrong with any of them.
    """
    attitude = alone()
    worst, every = 0.0, round(100.0 / rate_hz)
    for k in range(900):
        t = 0.01 * k
        since = max(t - 4.0, 0.0)
        v, r = max(22.0 - 4.0 * since, 0.0), 0.3 if t >= 2.0 else 0.0
        a = -4.0 if since > 0.0 and v > 0.0 else 0.0
        if k % every == 0:
            attitude.speed(t, v)
        attitude.gyro(t, (0.0, 0.0, r))
        attitude.accel(t, (a, r * v, G))
        if 5.2 < t < 9.0:
            worst = max(worst, abs(math.degrees(attitude.estimate().roll)))
    return worst


def test_b1_a_braking_turn_reads_the_newest_speed() -> None:
    assert braking_turn(10.0) <= 0.7
    assert braking_turn(20.0) <= 0.4


def test_b2_angles_are_of_both_corrected_triads() -> None:
    """Claim 1, last step: a gyroscope that turns between two accelerometer samples turns them."""
    attitude = alone(rate_time=1.0)
    for k in range(200):
        attitude.gyro(0.02 * k, (0.0, 0.0, 0.0))
        attitude.accel(0.02 * k, (0.0, 0.0, G))
    for k in range(11):  # 0.2 rad about the forward axis, and no accelerometer
        attitude.gyro(4.0 + 0.01 * k, (2.0, 0.0, 0.0))
    assert attitude.estimate().roll == pytest.approx(0.2, abs=0.005 * 4.0)
    only = alone()
    only.gyro(0.0, (0.0, 0.0, 0.0))
    only.accel(0.0, (0.0, 0.0, G))
    only.gyro(0.1, (2.0, 0.0, 0.0))
    assert only.estimate().roll == 0.0


@pytest.mark.parametrize("lean", [(0.0, 0.0), (0.4, -0.3), (1.4, 0.2), (0.1, 3.0)])
def test_b2_the_vertical_is_carried_exactly(lean: tuple[float, float]) -> None:
    """Constant rate, no draw: the vertical in the body is the first one turned by -w t."""
    w, dt = np.array([0.7, -0.4, 0.9]), 0.01
    carried = CarriedAngles(1e9, 0.5)
    carried.draw(0.0, *lean)
    for k in range(301):
        carried.turn(dt * k, tuple(w))
    up = vertical(*lean)
    expected = Rotation.from_rotvec(-w * 3.0).apply(up)
    assert carried.angles is not None
    assert vertical(*carried.angles) == pytest.approx(tuple(expected), abs=1e-9)


@pytest.mark.parametrize("pitch_deg", [-12.0, 12.0])
def test_b2_claims_1_to_3_together_in_one_mode(pitch_deg: float) -> None:
    """Speed over the map on a slope: with the deflection nearer the truth, and both triads used."""
    pitch, a = math.radians(pitch_deg), 3.0
    force = text.pitched(pitch).T @ [0.0, a, G]
    found = {}
    for horizontal in (True, False):
        speed_is = "horizontal" if horizontal else "along_road"
        attitude = alone(rate_time=1.0, speed_is=speed_is)
        for k in range(500):
            t = 0.02 * k
            attitude.speed(t, 5.0 + a * t)
            attitude.gyro(t, (0.0, 0.0, 0.0))
            attitude.accel(t, (force[1], -force[0], force[2]))
        found[horizontal] = abs(-attitude.estimate().pitch - pitch)
    assert found[True] < 0.1 * found[False]


def fed(
    attitude: CompensatedAttitude,
    t: float,
    seconds: float,
    error: float,
    speed: float | None,
    noise: tuple[float, float],
) -> float:
    """Give samples of some seconds with a zero error about every axis; return the time after it.

    noise: standard deviations of angular rate [rad/s] and force [m/s^2].
    """
    rng = np.random.default_rng(int(t))
    for k in range(round(seconds * 50.0)):
        now = t + 0.02 * k
        if speed is not None and k % 10 == 0:
            attitude.speed(now, speed)
        w, f = rng.normal(error, noise[0], 3), rng.normal(0.0, noise[1], 3) + UP
        attitude.gyro(now, w.tolist())
        attitude.accel(now, f.tolist())
    return t + seconds


def rest(attitude: CompensatedAttitude, t: float, seconds: float, error: float,
         with_speed: bool = True) -> float:  # fmt: skip
    """Stand for some seconds; see `fed`."""
    return fed(attitude, t, seconds, error, 0.0 if with_speed else None, (0.001, 0.01))


def drive(attitude: CompensatedAttitude, t: float, seconds: float, error: float,
          with_speed: bool = True) -> float:  # fmt: skip
    """Drive over rough ground for some seconds; see `fed`."""
    return fed(attitude, t, seconds, error, 8.0 if with_speed else None, (0.05, 0.6))


@pytest.mark.parametrize("with_speed", [True, False])
def test_b3_the_zero_error_is_that_of_now(with_speed: bool) -> None:
    """Claim 1: "at the current moment": each rest renews it, also where no speed says so."""
    attitude = CompensatedAttitude()
    t = rest(attitude, 0.0, 60.0, 0.01, with_speed)
    assert attitude.estimate().bias == pytest.approx((0.01,) * 3, abs=3e-4)
    t = drive(attitude, t, 60.0, 0.02, with_speed)
    t = rest(attitude, t, 60.0, 0.02, with_speed)
    assert attitude.estimate().bias == pytest.approx((0.02,) * 3, abs=3e-4)


@pytest.mark.slow
def test_kingston_b_alone_is_the_claims_b() -> None:
    """All samples of the van: the same angles, and the same figures against its INS."""
    samples = recording("kingston_2008")
    events = sorted(
        (t, rank, v)
        for rank, channel in enumerate(("speed", "gyro", "accel"))
        for t, v in zip(*(column.tolist() for column in samples[channel]), strict=True)
    )
    settings = MotionCompensationSettings(delay=-0.2)
    ours = CompensatedAttitude(AttitudeSettings(compensation=settings))
    theirs = text.Correction(delay=-0.2)
    rate, found = None, []
    for t, rank, value in events:
        if rank == 0:
            ours.speed(t, value)
            theirs.speed(t, value)
        elif rank == 1:
            rate = np.array(value)
            ours.gyro(t, (value[1], -value[0], value[2]))  # the sensor's axes are right, forward
        elif rate is not None:
            ours.accel(t, (value[1], -value[0], value[2]))
            theirs.zero_error = np.array(ours.motion_compensation.zero_error)
            *_, (pitch, roll) = theirs.take(t, value, rate)
            e = ours.estimate()
            found.append((t, e.roll - roll, -e.pitch - pitch, roll, pitch))
    table_ = np.array(found)
    apart = np.abs(table_[:, 1:3])
    assert np.degrees(np.median(apart)) < 1e-9
    assert np.degrees(apart.max()) < 1e-6
    ins = table("kingston_2008", "ins_truth.csv.gz")
    use = ins["time_s"] > ins["time_s"][0] + 60.0
    at = np.searchsorted(table_[:, 0], ins["time_s"][use], side="right") - 1
    rms = [
        float(np.sqrt(np.mean((np.degrees(table_[at, column]) - ins[f"{name}_deg"][use]) ** 2)))
        for column, name in ((3, "roll"), (4, "pitch"))
    ]
    assert rms[0] < 0.9
    assert rms[1] < 1.8
