"""Tables of different rates on one: nothing faster gets through, holes stay holes."""

from __future__ import annotations

import numpy as np
import pytest
from replayed_drive import drive

import imucald
from imucald.api.columns import columns_from, corrected_columns
from imucald.api.resampling import resampled


def test_tables_of_different_rates_are_joined_on_request_only():
    found = drive().resample(10.0, ("accel", "raw/speed"))
    assert found.column_names == [
        "t_s",
        "accel_x_mps2",
        "accel_y_mps2",
        "accel_z_mps2",
        "raw_speed_mps",
    ]
    t = found["t_s"].to_numpy()
    assert np.allclose(t * 10, np.rint(t * 10))
    speed, table = found["raw_speed_mps"].to_pandas(), drive().tables["raw/speed"]
    at = np.interp(t, table["t_s"], table["raw_speed_mps"])
    inner = (t > 1) & (t < t[-1] - 1)
    assert np.abs(speed - at)[inner].max() < 0.3
    first = drive().first_usable_s
    assert found["accel_x_mps2"].to_pandas()[t < first - 1].isna().all()
    assert found["accel_x_mps2"].to_pandas()[(t > first + 1) & inner].notna().all()
    assert found.schema.field("accel_x_mps2").metadata == {b"unit": b"m/s^2"}


@pytest.mark.parametrize("wrong", [0.0, -1.0, float("nan"), float("inf")])
def test_a_rate_that_is_none_is_refused(wrong):
    with pytest.raises(imucald.ImucaldError, match="rate must be positive"):
        drive().resample(wrong)


def test_events_cannot_be_resampled():
    with pytest.raises(imucald.ImucaldError, match="events is not a table of samples"):
        drive().resample(1.0, ("events",))


def tone(frequency: float, rate: float = 100.0, seconds: float = 60.0):
    """A table with a tone in x, and a hole of a second in the middle."""
    t = np.arange(0, seconds, 1 / rate)
    t = t[(t < seconds / 2) | (t > seconds / 2 + 1)]
    x = np.sin(2 * np.pi * frequency * t)
    zero = np.zeros(len(t))
    return columns_from(corrected_columns("accel"), [t, zero, x, zero, zero, zero])


def resampled_tone(frequency: float, rate: float):
    found = resampled({"accel": tone(frequency)}, rate)
    return found["t_s"], found["accel_x_mps2"]


def test_what_is_faster_than_half_the_new_rate_is_gone():
    for frequency in (5.0, 7.3, 10.0, 33.0, 48.0):
        _, x = resampled_tone(frequency, 10.0)
        assert np.nanmax(np.abs(x[5:-5])) < 0.08, frequency
    _, slow = resampled_tone(0.5, 10.0)
    assert np.nanmax(np.abs(slow)) > 0.9


def test_holes_stay_holes():
    for rate in (10.0, 250.0):
        t, x = resampled_tone(0.5, rate)
        inside = (t > 30.02) & (t < 30.98)
        assert np.isnan(x[inside]).all()
        assert not np.isnan(x[(t > 0.1) & (t < 29.9)]).any()
        assert not np.isnan(x[(t > 31.1) & (t < 59.8)]).any()
