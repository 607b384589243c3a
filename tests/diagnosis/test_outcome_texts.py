"""What an outcome says of a cause's size, in words that can be understood without the code."""

from __future__ import annotations

import made_diagnosis as made
import numpy as np
import pytest

from imucald.diagnosis.fit.intervals import Estimate
from imucald.diagnosis.fit.score import Hypothesis
from imucald.diagnosis.outcome import (
    _against,
    implausible,
    other_candidates,
    with_sensor_axes,
)
from imucald.diagnosis.result import OTHERWISE, Estimated, FoundCause
from imucald.diagnosis.search.state import State
from imucald.diagnosis.search.trials import Trial
from imucald.model.model import VehicleModel
from imucald.report import wording as words

NAMED_FROM = 0.4
"""Tolerance 0.1, and three deviations of 0.1."""


def of(value: float, key: str = "accel.scale.0", name: str = "accel_scale") -> Trial:
    """A trial whose cause may be within 1 of the model file."""
    one = np.ones(1)
    e = Estimate(value * one, 0.1 * one, 3.0, 5.0, 0.2 * one)
    range_of = np.array([[-1.0, 1.0]])
    h = Hypothesis(name, (key,))
    return Trial(h, e, np.ones(4), 20.0, 0.1 * one, range_of, 8.0, 2.0, 0.1 * one, np.arange(4))


def state(**trials: list[Trial]) -> State:
    model = VehicleModel()
    return State((), model, model, {}, **trials)


@pytest.mark.parametrize(("size", "is_large"), [(0.3, False), (0.5, True), (-0.5, True)])
def test_a_cause_that_is_large_enough_and_not_named_says_why(size, is_large):
    (found,) = other_candidates(state(doubtful=[of(size)]))
    assert found.outcome == "not ruled out"
    end = OTHERWISE if is_large else ""
    assert found.text == f"accel.scale.0 is off by {size} +- 0.2; threshold {NAMED_FROM}{end}"


def test_a_number_with_a_unit_has_it_and_a_pure_number_has_none():
    zero = of(0.3, "accel.bias.x", "accel_bias")
    (found,) = other_candidates(state(doubtful=[zero]))
    assert "off by 0.3 +- 0.2 m/s^2; threshold" in found.text
    for trial, text in ((of(2.0), "off by 2 +- 0.2 explains"), (zero, "off by 0.3 +- 0.2 m/s^2 ")):
        (left,) = implausible(state(implausible=[trial]))
        assert text in left.text


def test_a_value_that_differs_between_quarters_is_said_with_its_unit():
    zero = of(0.3, "accel.bias.x", "accel_bias")
    for trial, text in ((of(0.3), "moves by 0.2 between"), (zero, "moves by 0.2 m/s^2 between")):
        (against,) = _against(state(), trial)
        assert text in against


def test_what_is_too_small_is_said_with_the_size_from_which_it_would_have_shown():
    (found,) = other_candidates(state(last=[of(0.02, "speed.scale", "wheel_speed_scale")]))
    assert found.outcome == "not decidable here"
    assert (found.key, found.off, found.std) == ("speed.scale", 0.02, 0.1)
    assert found.shows_from == pytest.approx(NAMED_FROM)
    (row,) = words.not_named(made.found(candidates=(found,)))
    assert row.value == "speed gain error: 2 ± 20 %"
    assert row.shows == "from 40.0 % on"


def test_a_vector_is_along_the_sensors_axes_under_the_files_key():
    """Three zero errors put in along the sensor's axes, of a sensor that lies on its side."""
    zero = np.radians([0.25, -0.40, 0.15])
    turns = {"mount.roll_deg": 178.0, "mount.pitch_deg": -12.0, "mount.yaw_deg": 94.0}
    model = VehicleModel().with_changes(turns)
    r, p, y = np.radians([178.0, -12.0, 94.0])
    R = (
        np.array([[np.cos(y), -np.sin(y), 0.0], [np.sin(y), np.cos(y), 0.0], [0.0, 0.0, 1.0]])
        @ np.array([[np.cos(p), 0.0, np.sin(p)], [0.0, 1.0, 0.0], [-np.sin(p), 0.0, np.cos(p)]])
        @ np.array([[1.0, 0.0, 0.0], [0.0, np.cos(r), -np.sin(r)], [0.0, np.sin(r), np.cos(r)]])
    )
    parameters = {
        f"gyro.bias.{axis}": Estimated(float(x), 1e-4, "rad/s", 0.0, 1e-3)
        for axis, x in zip("xyz", R @ zero, strict=True)
    }
    found = with_sensor_axes(FoundCause("gyro_bias", parameters, (), {}, ""), model, model)
    assert [found.in_file[f"gyro.bias.{i}"].value for i in range(3)] == pytest.approx(zero)
    assert found.in_file["gyro.bias.0"].std == pytest.approx(1e-4)
    assert list(found.along_vehicle) == [f"gyro.bias.{w}" for w in ("forward", "left", "up")]
    said = made.found(causes=(found,)).as_json()["causes"][0]
    assert list(said["parameters"]) == ["gyro.bias.0", "gyro.bias.1", "gyro.bias.2"]
    assert said["parameters"]["gyro.bias.1"]["value"] == pytest.approx(zero[1], abs=1e-8)
    assert said["vehicle_axes"]["gyro.bias.up"]["value"] == pytest.approx((R @ zero)[2], abs=1e-8)
    rows = words.parameter_rows(found)
    assert [row.key for row in rows] == [*said["parameters"], "", "", ""]
    assert [row.title for row in rows[1::3]] == [
        "gyroscope zero error, sensor y", "gyroscope zero error, left",
    ]  # fmt: skip
