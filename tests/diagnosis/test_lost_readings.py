"""Readings that jump to one value and back are none, whichever value that is."""

from __future__ import annotations

import numpy as np
import pytest

from imucald.core.samples import Series
from imucald.diagnosis.diagnose import _shows_zero
from imucald.diagnosis.direct.single_values import all_lost, as_structure, lost_readings
from imucald.diagnosis.result import Kind, Structure

RATE_HZ, SECONDS = 50.0, 300.0
SIGNALS = 5


def sensor(seed=0, lsb=0.02) -> Series:
    """An upright accelerometer on a rough road, with potholes."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, SECONDS, 1.0 / RATE_HZ)
    slow = np.cumsum(rng.standard_normal((len(t), 3)), axis=0) * 0.02
    x = slow - slow.mean(axis=0) + [0.0, 0.0, 9.81] + 0.3 * rng.standard_normal((len(t), 3))
    x += rng.standard_t(2.5, (len(t), 3)) * 0.3
    return Series(t, np.round(x / lsb) * lsb)


def opened(whole: Series, value: tuple[float, float, float], times=12) -> tuple[Series, np.ndarray]:
    """A contact opens for 0.3 s now and then."""
    rng, x = np.random.default_rng(9), whole.values.copy()
    rows = np.zeros(len(x), dtype=bool)
    for start in rng.choice(np.arange(0, len(x) - 50, 40), times, replace=False):
        rows[start : start + 15] = True
    x[rows] = value
    return Series(whole.t, x), rows


@pytest.mark.parametrize("value", [(0.0, 0.0, 0.0), (0.02, -0.04, 0.06), (-19.6, -19.6, -19.6)])
def test_what_a_contact_that_opens_shows_is_found_row_by_row(value):
    series, rows = opened(sensor(), value)
    lost = lost_readings(series, SIGNALS)
    assert lost is not None
    assert lost.value == pytest.approx(value)
    assert (lost.rows == rows).all()
    assert len(lost.kept(series).t) == int((~rows).sum())
    structure = as_structure("accel", lost)
    assert structure.kind == Kind.READINGS_LOST
    assert "m/s^2" in structure.text


@pytest.mark.parametrize("lsb", [0.002, 0.125])
@pytest.mark.parametrize("seed", range(4))
def test_a_sound_sensor_loses_nothing(seed, lsb):
    assert all_lost({"accel": sensor(seed, lsb)}) == {}


@pytest.mark.parametrize("share", [0.002, 0.01, 0.05])
def test_a_range_that_ends_is_reached_from_close_by_also_by_potholes(share):
    whole = sensor(1).values[:, 0]
    rail = float(np.quantile(np.abs(whole), 1.0 - share))
    t = sensor(1).t
    assert lost_readings(Series(t, np.clip(whole, -rail, rail)), SIGNALS) is None


def test_a_dead_zone_is_entered_by_small_steps():
    t = np.arange(0.0, SECONDS, 0.02)
    x = (
        np.sin(t / 3.0)
        + 0.3 * np.sin(t * 2.0)
        + 0.01 * np.random.default_rng(2).normal(size=len(t))
    )
    shown = np.sign(x) * np.maximum(np.abs(x) - 0.1, 0.0)
    assert lost_readings(Series(t, np.round(shown, 3)), SIGNALS) is None


def test_blows_beyond_a_range_of_one_number_are_no_lost_readings():
    """Kerbs that push a sideways sensor onto either rail, each for one sample."""
    rng = np.random.default_rng(3)
    t = np.arange(0.0, SECONDS, 1.0 / RATE_HZ)
    x = np.cumsum(rng.standard_normal(len(t))) * 0.01 + 0.1 * rng.standard_normal(len(t))
    hit = rng.choice(np.arange(1, len(t) - 1, 20), 60, replace=False)
    x[hit] = 40.0 * np.where(rng.random(60) < 0.5, 1.0, -1.0)
    rail = 18.0
    assert lost_readings(Series(t, np.round(np.clip(x, -rail, rail), 2)), SIGNALS) is None


def test_a_signal_of_one_number_that_falls_back_to_its_largest_value_loses_readings():
    rng = np.random.default_rng(3)
    t = np.arange(0.0, SECONDS, 1.0 / RATE_HZ)
    x = np.cumsum(rng.standard_normal(len(t))) * 0.01 + 0.1 * rng.standard_normal(len(t))
    hit = rng.choice(np.arange(1, len(t) - 1, 20), 60, replace=False)
    x[hit] = 20.47
    x[10] = -12.0  # one blow the other way is no range that ends there
    lost = lost_readings(Series(t, np.round(x, 2)), SIGNALS)
    assert lost is not None
    assert np.flatnonzero(lost.rows).tolist() == sorted(hit.tolist())


def test_lost_readings_do_not_say_that_the_zero_at_stops_is_held():
    """They are not used: what stops show of a gyroscope's zero stands."""
    series, _ = opened(sensor(), (0.0, 0.0, 0.0))
    lost = lost_readings(series, SIGNALS)
    assert lost is not None
    assert _shows_zero([as_structure("gyro", lost)])


@pytest.mark.parametrize(("signal", "kind", "parameter", "shows"), [
    ("gyro_x", Kind.VALUE_HELD, "", False), ("gyro", Kind.GOES_WITH_ANOTHER, "", False),
    ("gyro_x", Kind.WANDERS, "gyro.bias.x", False), ("accel_x", Kind.WANDERS, "accel.bias.x", True),
])  # fmt: skip
def test_a_zero_that_is_not_the_same_all_along_is_not_what_stops_show(
    signal, kind, parameter, shows
):
    assert _shows_zero([Structure(signal, kind, 2.0, "", parameter)]) == shows
