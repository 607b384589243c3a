"""What an outcome says of a cause's size, in words that can be understood without the code."""

from __future__ import annotations

import numpy as np
import pytest

from imucald.diagnosis.fit.intervals import Estimate
from imucald.diagnosis.fit.score import Hypothesis
from imucald.diagnosis.outcome import OTHERWISE, _against, implausible, other_candidates
from imucald.diagnosis.search.state import State
from imucald.diagnosis.search.trials import Trial
from imucald.model.model import VehicleModel

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
    assert found.text == f"accel.scale.0 off by {size} +- 0.2; threshold {NAMED_FROM}{end}"


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
