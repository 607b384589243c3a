"""Ticks of signals that are differently late come out as of one time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imucald.core.samples import Series
from imucald.model_compensation.tick_preprocessing import TimeAlignment, alignment_shifts
from imucald.motion import ticks as tk
from imucald.motion.column_ticks import ticks_from_samples

SLOPE = 0.37
LATE = st.floats(0.0, 1.5)


def ramp(latency, rate, width):
    """Samples that say SLOPE times the instant that they are of."""
    t = np.arange(0.003, 8.0, 1.0 / rate)
    values = SLOPE * (t - latency)
    return Series(t, np.tile(values[:, None], (1, width)) if width > 1 else values)


@settings(max_examples=40, deadline=None)
@given(accel=LATE, gyro=LATE, speed=LATE, yaw=LATE, speed_rate=st.sampled_from([10.0, 25.0, 50.0]))
def test_all_channels_are_of_one_time(accel, gyro, speed, yaw, speed_rate):
    latency = {"accel": accel, "gyro": gyro, "speed": speed, "yaw_rate": yaw}
    samples = {
        "accel": ramp(accel, 100.0, 3),
        "gyro": ramp(gyro, 200.0, 3),
        "speed": ramp(speed, speed_rate, 1),
        "yaw_rate": ramp(yaw, 100.0, 1),
    }
    shifts = alignment_shifts(latency)
    if not shifts:
        return
    time_alignment = TimeAlignment(shifts)
    rows = np.array([time_alignment.row(r) for r in ticks_from_samples(samples, 0, 80).tolist()])[
        40:
    ]
    # what the estimator takes as the instant of each mean, and what the mean says of it
    behind = [
        rows[:, tk.T] - rows[:, age] - rows[:, value] / SLOPE
        for value, age in ((tk.ACCEL.x, tk.ACCEL.age), (tk.GYRO.y, tk.GYRO.age),
                           (tk.SPEED.mean, tk.SPEED.age))
    ]  # fmt: skip
    behind.append(rows[:, tk.T] - 0.05 - rows[:, tk.YAW_RATE.mean] / SLOPE)
    for channel in behind[1:3]:
        np.testing.assert_allclose(channel, behind[0], atol=2e-3)
    np.testing.assert_allclose(behind[3], behind[0], atol=6e-3)  # it states no age
    ages = rows[:, [tk.ACCEL.age, tk.GYRO.age, tk.SPEED.age]]
    assert (np.abs(ages) <= 0.1001).all(), "older ones count as impossible"


def test_equal_delays_need_nothing():
    assert alignment_shifts({"accel": 0.2, "gyro": 0.2, "speed": 0.2}) == {}
    assert alignment_shifts({}) == {}


def test_the_accelerometers_ticks_stay_whole():
    shifts = alignment_shifts({"accel": 0.03, "speed": 0.4, "gyro": 0.05})
    assert shifts["accel"] == pytest.approx(round(10 * shifts["accel"]) / 10)
    assert shifts["speed"] == pytest.approx(shifts["accel"] - 0.37)


def test_a_jump_of_time_joins_nothing():
    time_alignment = TimeAlignment(alignment_shifts({"accel": 0.0, "speed": 0.35}))
    row = ticks_from_samples({"accel": ramp(0.0, 100.0, 3)}, 3, 4)[0].tolist()
    for _ in range(6):
        filled = time_alignment.row(row)
    assert filled[tk.ACCEL.n] == 10
    time_alignment.gap()
    assert time_alignment.row(row)[tk.ACCEL.n] == 0


def test_flags_and_temperature_keep_their_place():
    time_alignment = TimeAlignment(alignment_shifts({"accel": 0.0, "reverse": 0.28}))
    row = list(ticks_from_samples({}, 0, 1)[0])
    row[tk.REVERSE], row[tk.TEMPERATURE], row[tk.BRAKE] = 1.0, 30.0, 1.0
    first = time_alignment.row(row)
    assert first[tk.REVERSE] == 1.0
    assert first[tk.TEMPERATURE] == 30.0
    assert np.isnan(first[tk.BRAKE]), "as late as the accelerometer: held back with it"
