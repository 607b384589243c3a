"""A course of a receiver is compared with the other measurements of the yaw rate."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from imucald.config.vehicle import VehicleSettings
from imucald.config_check.finding import Finding
from imucald.config_check.judgement import judge
from imucald.config_check.motion import Motion, TickMeans
from imucald.core.samples import Samples, Series
from imucald.simulation import random_model, simulate

VEHICLE = VehicleSettings(track=1.5, wheelbase=2.7, steering_ratio=16.0)
LATE_S = 0.5


@functools.cache
def with_a_course() -> Samples:
    """A drive with a course [rad], clockwise from 0 to a full turn, once a second and late."""
    drive = simulate(random_model(31), 31, 6.0)
    gyro, speed = drive.samples["gyro"], drive.samples["speed"]
    rate = gyro.values @ drive.truth.R_vehicle_from_sensor()[2]
    turned = np.cumsum(rate) * float(np.median(np.diff(gyro.t)))
    t = np.arange(gyro.t[0], gyro.t[-1], 1.0)
    course = np.mod(1.0 - np.interp(t, gyro.t, turned), 2.0 * np.pi)
    samples = {"gyro": gyro, "accel": drive.samples["accel"], "speed": speed}
    return samples | {"heading": Series(t + LATE_S, course)}


def judged(samples: Samples, chunks: int = 1) -> list[Finding]:
    means = TickMeans()
    end = samples["gyro"].t[-1] + 1.0
    for k in range(chunks):
        means.add_samples(
            {
                name: Series(series.t[here], series.values[here])
                for name, series in samples.items()
                for here in [(series.t >= end * k / chunks) & (series.t < end * (k + 1) / chunks)]
            }
        )
    return list(judge(Motion(means.grid(), planar=False), VEHICLE))


@pytest.mark.parametrize("chunks", [1, 40])
def test_a_course_confirms_the_sign_of_the_gyroscope(chunks):
    found = judged(with_a_course(), chunks)
    assert "has the same sign in turns as heading" in {f.text for f in found if f.level == "ok"}
    assert "error" not in {f.level for f in found}


def test_a_course_with_a_wrong_sign_is_an_error():
    samples = dict(with_a_course())
    course = samples["heading"]
    samples["heading"] = Series(course.t, np.mod(-course.values, 2.0 * np.pi))
    (found,) = (f for f in judged(samples) if f.level == "error")
    assert "heading: wrong sign (a heading must increase in right turns" in found.text
    assert "accelerometer: wrong sign of all its axes" in found.text, "as likely by these signals"


def test_a_course_that_stays_accuses_nobody():
    samples = dict(with_a_course())
    course = samples["heading"]
    samples["heading"] = Series(course.t, np.full(len(course.t), 2.0))
    assert all(found.level != "error" for found in judged(samples))
