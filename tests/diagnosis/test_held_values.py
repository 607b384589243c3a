"""Values that are held."""

from __future__ import annotations

import numpy as np
import pytest

from imucald.core.samples import Series
from imucald.diagnosis.direct.faults import spans_of
from imucald.diagnosis.direct.single_values import held_values
from imucald.diagnosis.signals import drive_of

SECONDS = 300.0


def drive(dead=0.0, lsb=0.0005, noise=0.01):
    """A gyroscope that shows no rate below `dead` [rad/s], in steps of `lsb`."""
    rng = np.random.default_rng(2)
    t = np.arange(0.0, SECONDS, 0.01)
    slow = np.column_stack([0.1 * np.sin(t / k) for k in (3.0, 5.0, 7.0)])
    gyro = slow + noise * rng.standard_normal((len(t), 3))
    gyro = np.sign(gyro) * np.maximum(np.abs(gyro) - dead, 0.0)
    accel = rng.standard_normal((len(t), 3))
    accel[:, 2] += 9.81
    at = np.arange(0.0, SECONDS, 0.1)
    return drive_of(
        {
            "accel": Series(t, np.round(accel / 0.01) * 0.01),
            "gyro": Series(t, np.round(gyro / lsb) * lsb),
            "speed": Series(at, 15.0 + np.sin(at)),
        }
    )


def test_a_dead_zone_is_a_value_that_is_held():
    found = list(held_values([drive(dead=0.03)]))
    assert {s.signal for s in found} == {"gyro_x", "gyro_y", "gyro_z"}
    assert all("0 rad/s" in s.text for s in found)


@pytest.mark.parametrize(("lsb", "noise"), [(0.0005, 0.01), (0.02, 0.004)])
def test_a_sound_sensor_holds_no_value_nor_does_a_coarse_one(lsb, noise):
    assert list(held_values([drive(lsb=lsb, noise=noise)])) == []


def test_the_end_of_a_range_is_not_also_a_held_value():
    """A clipped axis was reported twice: as saturation, and as a pattern that no cause explains."""
    one = drive(dead=0.03)
    t, x = one.channels["gyro"].t, one.channels["gyro"].values
    at_end = x[:, 0] == 0.0
    samples = {
        name: Series(one.channels[name].t, one.channels[name].values) for name in ("accel", "gyro")
    } | {"speed": Series(one.knots.t, one.knots.values)}
    found = held_values([drive_of(samples, {"gyro": spans_of(t, at_end)})])
    assert "gyro_x" not in {s.signal for s in found}
