"""Whether a stay at one value is longer than a signal's own."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from imucald.core.samples import GRAVITY, Samples, Series
from imucald.diagnosis.direct.faults import find_faults
from imucald.diagnosis.direct.stuck import chance_of_any, chances_of_sensors, number_as_long
from imucald.model.model import VehicleModel

Draw = Callable[[np.random.Generator, int], np.ndarray]
LAWS: dict[str, Draw] = {
    "coin": lambda rng, n: rng.geometric(0.5, n),
    "town and motorway": lambda rng, n: rng.geometric(np.where(rng.random(n) < 0.8, 0.6, 0.1)),
    "log-normal": lambda rng, n: np.ceil(np.exp(rng.normal(0.5, 1.0, n))).astype(int),
    "tail of n^-2": lambda rng, n: np.ceil(rng.pareto(2.0, n)).astype(int) + 1,
}


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("count", [60, 300])
def test_the_longest_of_a_sound_signal_is_called_too_long_no_oftener_than_is_said(law, count):
    rng, numbers = np.random.default_rng(3), []
    for _ in range(100):
        stays = LAWS[law](rng, count)
        longest = int(np.argmax(stays))
        numbers.append(number_as_long(np.delete(stays, longest), int(stays[longest])))
    # 5 of 100, and three deviations of such a count.
    assert np.sum(np.array(numbers) < 0.05) <= 11
    assert np.median(numbers) < 3.0


def test_what_is_too_long_beside_short_stays_is_usual_beside_long_ones():
    rng = np.random.default_rng(4)
    assert number_as_long(rng.geometric(0.7, 200), 29) < 0.1
    assert number_as_long(LAWS["town and motorway"](rng, 200), 29) > 0.5


def test_beside_no_other_stay_none_is_too_long():
    assert number_as_long(np.zeros(0, dtype=np.intp), 1000) == 1.0
    assert number_as_long(np.ones(3, dtype=np.intp), 1000) < 0.1


@pytest.mark.parametrize("asked", [1, 10])
@pytest.mark.parametrize("factors", [1, 2, 3])
def test_of_many_sound_stays_few_are_called_by_chance(asked, factors):
    """The first factor is the number of those asked that are as long."""
    rng = np.random.default_rng(5)
    hits = 0
    for _ in range(1000):
        chances = rng.random((asked, factors))
        products = asked * np.prod(chances, axis=1)
        hits += min(chance_of_any(float(x), factors, asked) for x in products) < 0.05
    assert 25 < hits < 75


def town(seed: int, slopes: float, lsb: float = 0.01) -> dict[str, Series]:
    """Speed once a second, kept for some seconds now and then, on a road with slopes that hide from
    the accelerometer much of how it changes. slopes: rms [m/s^2]."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 1500.0, 1.0)
    rate = np.convolve(rng.standard_normal(len(t) + 8), np.hanning(9), "valid")
    for start in np.arange(10, len(t) - 20, 25):
        rate[start : start + rng.geometric(0.4)] = 0.0
    v = 14.0 + 4.0 * np.sin(0.1 * np.cumsum(rate))
    fine = np.arange(0.0, 1500.0, 0.05)
    force = 0.1 * rng.standard_normal((len(fine), 3)) + [0.0, 0.0, GRAVITY]
    force[:, 0] += np.interp(fine, t, np.gradient(v))
    slope = np.convolve(rng.standard_normal(len(fine)), np.hanning(400), "same")
    force[:, 0] += slopes * slope / slope.std()
    return {"accel": Series(fine, force), "speed": Series(t, np.round(v / lsb) * lsb)}


def motorway(seed: int) -> dict[str, Series]:
    """Twice a second in whole km/h, at a speed that is hardly changed for minutes."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 1500.0, 0.5)
    keen = np.where((t // 120.0) % 3 == 0, 0.03, 0.3)
    rate = keen * np.convolve(rng.standard_normal(len(t) + 40), np.hanning(41) / 4.0, "valid")
    v = np.cumsum(rate) * 0.5
    v = 30.0 + v - np.convolve(np.pad(v, 200, "edge"), np.ones(401) / 401, "valid")
    force = 0.2 * rng.standard_normal((len(t) * 10, 3)) + [0.0, 0.0, GRAVITY]
    fine = np.arange(len(force)) * 0.05
    force[:, 0] += np.interp(fine, t, rate)
    return {"accel": Series(fine, force), "speed": Series(t, np.round(v * 3.6) / 3.6)}


def held(samples: Samples, start: int, count: int) -> dict[str, Series]:
    t, v = samples["speed"].t, samples["speed"].values.copy()
    v[start : start + count] = v[start]
    return {**samples, "speed": Series(t, v)}


def filtered(samples: Samples, seconds: float) -> dict[str, Series]:
    """The speed behind a low-pass of the first order, in doubles: in the end it stays as well."""
    t, x = samples["speed"].t, samples["speed"].values
    keep, y = np.exp(-np.diff(t) / seconds), x.copy()
    for k in range(1, len(x)):
        y[k] = keep[k - 1] * y[k - 1] + (1.0 - keep[k - 1]) * x[k]
    return {**samples, "speed": Series(t, y)}


def stuck(samples: Samples) -> list[tuple[float, float]]:
    return [span for f in find_faults(samples, VehicleModel()) for span in f.spans
            if f.cause == "stuck_signal"]  # fmt: skip


def longest(samples: Samples) -> int:
    return int(np.diff(np.flatnonzero(np.diff(samples["speed"].values) != 0.0)).max()) - 1


def test_length_release_and_sensors_are_enough_together_where_none_is_by_itself():
    """28 steps beside 11 of its own; slopes hide the speed's change, a little or all of it."""
    assert longest(town(2, 0.1)) > 28 / 4
    seen, hidden = (held(town(2, slopes), 1100, 29) for slopes in (0.1, 0.5))
    for samples in (seen, hidden):
        assert chances_of_sensors(samples, ((1100.0, 1128.0),))[0][0] > 0.01
    [(low, high)] = stuck(seen)
    assert (low, high) == (pytest.approx(1100.0, abs=2.0), pytest.approx(1128.0, abs=2.0))
    assert stuck(hidden) == []


@pytest.mark.parametrize("seed", range(3))
def test_a_finely_resolved_speed_that_holds_is_found_though_it_goes_on_from_there(seed):
    """Ten times a second in steps of 0.01 m/s; nothing else is fine enough to speak against it."""
    samples, rng = town(seed, 0.5), np.random.default_rng(seed)
    t = np.arange(0.0, 1500.0, 0.1)
    v = np.interp(t, samples["speed"].t, samples["speed"].values)
    v += 0.03 * rng.standard_normal(len(t))
    v[7290:] += v[7000] - v[7290]
    v = np.round(v / 0.01) * 0.01
    sound = {**samples, "speed": Series(t, v)}
    assert stuck(sound) == []
    [(low, high)] = stuck(held(sound, 7000, 290))
    assert (low, high) == (pytest.approx(700.0, abs=0.5), pytest.approx(729.0, abs=0.5))


@pytest.mark.parametrize("seed", range(4))
def test_a_cruise_is_not_stuck_in_whole_kmh_nor_behind_a_filter(seed):
    samples = motorway(seed)
    assert longest(samples) > 30
    assert stuck(samples) == []
    assert longest(filtered(samples, 0.1)) > 16  # 8 s, from which on it is asked
    for seconds in (0.1, 0.2, 0.3, 0.6):
        assert stuck(filtered(samples, seconds)) == []


@pytest.mark.parametrize("seed", range(4))
def test_a_town_is_not_stuck(seed):
    for lsb in (0.01, 1.0 / 3.6):
        assert stuck(town(seed, 0.1, lsb)) == []


@pytest.mark.parametrize("is_held", [False, True])
def test_a_steering_angle_that_stays_on_a_nearly_straight_road_is_stuck(is_held):
    """The yaw rate hardly changes meanwhile: a rule that asked it to do so hid such stays."""
    rng = np.random.default_rng(6)
    t = np.arange(0.0, 600.0, 0.02)
    bends = np.where((t > 290.0) & (t < 330.0), 0.05, 1.0) * np.sin(t / 4.0)
    angle = np.round((bends + 0.01 * np.sin(t / 0.7)) / 0.0017) * 0.0017
    if is_held:
        angle[(t > 300.0) & (t < 320.0)] = angle[np.searchsorted(t, 300.0)]
    force = 0.1 * rng.standard_normal((len(t), 3)) + [0.0, 0.0, GRAVITY]
    speed = Series(t[::10], np.full(len(t[::10]), 20.0) + 0.01 * rng.standard_normal(len(t[::10])))
    yaw_rate = Series(t, 0.08 * bends + 0.001 * rng.standard_normal(len(t)))
    samples = {"accel": Series(t, force), "speed": speed, "yaw_rate": yaw_rate}
    found = stuck({**samples, "steering": Series(t, angle)})
    assert len(found) == is_held
