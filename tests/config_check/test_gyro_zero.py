"""A zero error of a gyroscope without a stop is not taken for a wrong sign, nor hides one."""

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

ZERO = np.radians([0.64, 0.40, -0.24])
VEHICLE = VehicleSettings(track=1.5, wheelbase=2.7, steering_ratio=16.0)


@functools.cache
def without_a_stop(seed: int) -> Samples:
    """The longest part of a drive without a stop, in axes that are nearly the vehicle's."""
    drive = simulate(random_model(seed, standing_first=True), seed, 12.0)
    speed = drive.samples["speed"]
    edges = np.flatnonzero(np.diff(np.r_[0, (speed.values > 3.0).astype(int), 0]))
    starts, ends = edges[::2], edges[1::2]
    longest = int(np.argmax(ends - starts))
    start, end = speed.t[starts[longest]] + 1.0, speed.t[ends[longest] - 1] - 1.0
    R = drive.truth.R_vehicle_from_sensor()
    found = {}
    for channel in ("speed", "accel", "gyro"):
        series = drive.samples[channel]
        here = (series.t > start) & (series.t < end)
        values = series.values[here]
        found[channel] = Series(
            series.t[here] - start, values if values.ndim == 1 else values @ R.T
        )
    return found


def of_the_gyroscope(seed: int, signs: tuple[int, int, int], zero: np.ndarray) -> list[Finding]:
    samples = dict(without_a_stop(seed))
    gyro = samples["gyro"]
    samples["gyro"] = Series(gyro.t, gyro.values * np.array(signs) + zero)
    means = TickMeans()
    means.add_samples(samples)
    found = judge(Motion(means.grid(), planar=False), VEHICLE)
    return [f for f in found if f.quantity == "gyroscope" and f.level != "note"]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [66, 67, 68])
@pytest.mark.parametrize("zero", [0.0 * ZERO, ZERO], ids=["no zero error", "zero error"])
def test_right_signs_are_not_accused_and_wrong_ones_are(seed, zero):
    assert "error" not in {f.level for f in of_the_gyroscope(seed, (1, 1, 1), zero)}
    for signs, axis in (((1, -1, 1), "y"), ((-1, 1, 1), "x")):
        (found,) = of_the_gyroscope(seed, signs, zero)
        assert found.level == "error"
        assert f"wrong sign of its {axis} axis" in found.text
