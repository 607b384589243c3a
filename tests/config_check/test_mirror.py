"""Whether the accelerometer is mirrored, by the signs that the other signals need."""

from __future__ import annotations

import pytest

from imucald.discovery.heading import hold_against_usual_signs
from imucald.discovery.proposal import Choice, Proposed
from imucald.mount.mirror import DOUBTED, probability


def test_a_yaw_rate_that_counts_to_the_right_is_rarer_than_such_a_steering_angle():
    sound = {"gyroscope": False}
    yaw_rate = probability({**sound, "yaw_rate": True})
    steering = probability({**sound, "steering_wheel_angle": True})
    assert steering < DOUBTED < yaw_rate


@pytest.mark.parametrize(("has_bit", "is_sure"), [(True, True), (False, False)])
def test_a_sign_in_a_bit_of_its_own_says_nothing_of_the_accelerometer(has_bit, is_sure):
    axes = {axis: Proposed(f"IMU.Acc{axis}") for axis in "xyz"}
    bit = "CAR.Left" if has_bit else None
    turned = {"": Proposed("CAR.Value", sign=-1, sign_signal=bit)}
    accelerometer = Choice("accelerometer", axes, "1 g; the axes follow from the names")
    choices = [
        accelerometer,
        Choice("yaw_rate", turned, ""),
        Choice("steering_wheel_angle", turned, ""),
    ]
    hold_against_usual_signs(choices, None)
    assert accelerometer.is_sure == is_sure
