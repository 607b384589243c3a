"""A speed that is held while the accelerometer says that it changes."""

from __future__ import annotations

import numpy as np
import pytest

from imucald.core.samples import GRAVITY, Series
from imucald.diagnosis.direct.faults import find_faults
from imucald.diagnosis.direct.single_values import all_lost
from imucald.diagnosis.direct.stuck import chances_of_sensors
from imucald.model.model import VehicleModel

SECONDS = 1500.0
LSB_MPS = 1.0 / 3.6
CHANCE = 0.01
MODEL = VehicleModel().with_changes({"accel.rate_hz": 20.0, "speed.rate_hz": 1.0})


def drive(seed: int) -> dict[str, Series]:
    """Town traffic and stretches of cruise on a hilly road; speed once a second in whole km/h."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, SECONDS, 0.05)
    rate = np.convolve(rng.standard_normal(len(t)), np.hanning(160), "same")
    rate *= 0.5 / rate.std()
    # Every third half minute the speed is kept, but for what a cruise control lets through.
    rate *= np.where((t // 30.0) % 3 == 0, 0.05, 1.0)
    v = np.cumsum(rate) * 0.05
    v = 16.0 + v - np.convolve(v, np.ones(4001) / 4001, "same")
    road = np.convolve(rng.standard_normal(len(t)), np.hanning(600), "same")
    road *= 0.02 / road.std()
    noise = 0.05 * rng.standard_normal((len(t), 3))
    force = np.column_stack([np.gradient(v, 0.05) + GRAVITY * road, 0.0 * t, GRAVITY + 0.0 * t])
    gyro = np.column_stack([0.0 * t, -np.gradient(road, 0.05), 0.0 * t])
    # Sideways in its box: forward is the sensor's y.
    turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    seconds = np.arange(0.0, SECONDS, 1.0)
    return {
        "accel": Series(t, (force + noise) @ turned.T),
        "gyro": Series(t, (gyro + 0.001 * rng.standard_normal((len(t), 3))) @ turned.T),
        "speed": Series(seconds, np.round(np.interp(seconds, t, v) / LSB_MPS) * LSB_MPS),
    }


def held(samples: dict[str, Series], start: int, seconds: int) -> dict[str, Series]:
    values = samples["speed"].values.copy()
    values[start : start + seconds] = values[start]
    return {**samples, "speed": Series(samples["speed"].t, values)}


def stuck(samples: dict[str, Series]) -> list[tuple[float, float]]:
    faults = find_faults(samples, MODEL, all_lost(samples))
    return [span for f in faults if (f.cause, f.signal) == ("stuck_signal", "speed")
            for span in f.spans]  # fmt: skip


def longest_stay(samples: dict[str, Series]) -> int:
    x = samples["speed"].values
    edges = np.flatnonzero(np.diff(x) != 0.0)
    return int(np.diff(edges).max())


def test_a_cruise_is_held_by_nobody():
    samples = [drive(seed) for seed in range(4)]
    assert max(longest_stay(s) for s in samples) > 15
    assert all(stuck(s) == [] for s in samples)


def test_a_speed_that_is_held_as_long_as_a_cruise_is_found_by_the_accelerometer():
    for seed in range(4):
        samples = drive(seed)
        [(low, high)] = stuck(held(samples, 755, 25))
        assert 750.0 <= low <= 755.0
        assert 779.0 <= high <= 785.0


@pytest.mark.parametrize("seed", range(4))
def test_a_tenth_of_what_a_held_speed_hides_is_enough_to_contradict_it_and_none_is_not(seed):
    samples, span = drive(seed), (755.0, 779.0)
    true, t = samples["speed"].values, samples["speed"].t
    hidden = held(samples, 755, 25)["speed"].values - true
    assert chances_of_sensors(samples, (span,))[0][0] > CHANCE
    part = {**samples, "speed": Series(t, true + 0.1 * hidden)}
    assert chances_of_sensors(part, (span,))[0][0] < CHANCE


def test_without_an_accelerometer_that_speaks_against_it_nothing_is_said():
    samples = drive(0)
    still = Series(samples["accel"].t, np.tile([0.0, 0.0, GRAVITY], (len(samples["accel"].t), 1)))
    assert stuck({**held(samples, 755, 25), "accel": still}) == []


@pytest.mark.parametrize(("first", "last"), [(0.0, 770.0), (0.0, 700.0), (765.0, SECONDS)])
def test_nothing_is_said_of_a_stay_that_the_sensors_do_not_cover(first, last):
    """They end in it, before it, or begin in it: neither it nor any sound cruise is called held."""
    samples = held(drive(0), 755, 25)
    for name in ("accel", "gyro"):
        t, values = samples[name].t, samples[name].values
        there = (t >= first) & (t <= last)
        samples[name] = Series(t[there], values[there])
    assert stuck(samples) == []


def with_one_cruise(seed: int, step_s: float) -> dict[str, Series]:
    """Whole km/h: town traffic, and once a cruise of some two minutes on a hilly road."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, SECONDS, 0.05)
    rate = np.convolve(rng.standard_normal(len(t)), np.hanning(160), "same")
    rate *= 0.6 / rate.std()
    v = np.cumsum(rate) * 0.05
    v = 14.0 + v - np.convolve(np.pad(v, 2000, "edge"), np.ones(4001) / 4001, "valid")
    start = 200.0 + rng.uniform(0.0, 50.0)
    goal = np.maximum(v, 5.0)
    goal[(t > start) & (t < start + rng.uniform(80.0, 150.0))] = rng.uniform(27.0, 36.0)
    v = np.convolve(np.pad(goal, 75, "edge"), np.hanning(151) / np.hanning(151).sum(), "valid")
    road = np.convolve(rng.standard_normal(len(t)), np.hanning(600), "same")
    road *= 0.02 / road.std()
    force = np.column_stack([np.gradient(v, 0.05) + GRAVITY * road, 0.0 * t, GRAVITY + 0.0 * t])
    gyro = np.column_stack([0.0 * t, -np.gradient(road, 0.05), 0.0 * t])
    at_s = np.arange(0.0, SECONDS, step_s)
    return {
        "accel": Series(t, force + 0.1 * rng.standard_normal((len(t), 3))),
        "gyro": Series(t, gyro + 0.002 * rng.standard_normal((len(t), 3))),
        "speed": Series(at_s, np.round(np.interp(at_s, t, v) / LSB_MPS) * LSB_MPS),
    }


@pytest.mark.parametrize("step_s", [0.1, 1.0])
@pytest.mark.parametrize("seed", range(6))
def test_one_cruise_in_a_drive_is_not_stuck(seed, step_s):
    """It is longer than all other stays and ends with braking; the accelerometer agrees with it."""
    samples = with_one_cruise(seed, step_s)
    assert longest_stay(samples) > 60.0 / step_s
    assert stuck(samples) == []


@pytest.mark.parametrize("seed", range(4))
def test_a_speed_that_stays_at_zero_while_the_vehicle_drives_off_is_stuck(seed):
    """It stops at 700 s for 20 s, and the speed stays at 0 for 30 s more."""
    samples = drive(seed)
    t = np.arange(0.0, SECONDS, 0.05)
    share = np.clip(np.minimum((t - 740.0) / 10.0, 1.0), 0.0, 1.0)
    share[t < 720.0] = np.clip((710.0 - t[t < 720.0]) / 10.0, 0.0, 1.0)
    rng = np.random.default_rng(seed)
    rate = np.convolve(rng.standard_normal(len(t)), np.hanning(160), "same")
    v = np.maximum(16.0 + 4.0 * np.convolve(rate / rate.std(), np.ones(60) / 60, "same"), 5.0)
    v = v * share
    force = samples["accel"].values.copy()
    sound = np.interp(t, samples["speed"].t, samples["speed"].values)
    force[:, 1] += np.gradient(v, 0.05) - np.gradient(sound, 0.05)
    shown = np.round(np.interp(samples["speed"].t, t, v) / LSB_MPS) * LSB_MPS
    changed = {**samples, "accel": Series(t, force)}
    assert stuck({**changed, "speed": Series(samples["speed"].t, shown)}) == []
    shown[(samples["speed"].t > 710.0) & (samples["speed"].t < 775.0)] = 0.0
    [(low, high)] = stuck({**changed, "speed": Series(samples["speed"].t, shown)})
    assert low == pytest.approx(710.0, abs=2.0)
    assert high == pytest.approx(775.0, abs=2.0)
