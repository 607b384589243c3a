"""What `check` advises where frames are rejected, or a signal has a wrong gain."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from imucald.config_check.axes import gain_findings
from imucald.config_check.decoding import _REMEDIES, _remedy
from imucald.inputs.rate_guard import DUPLICATE, TOO_FAST


@pytest.mark.parametrize(("reasons", "key"), [
    ({"counter_jump": 5, "untrusted": 15}, "counter"),
    ({"checksum": 5, "untrusted": 15}, "checksum"),
    ({"doubled": 900, "counter_repeated": 3}, "doubled"),
    ({"too_early": 2}, "too_early"),
    ({DUPLICATE: 2}, "duplicate_sender"), ({TOO_FAST: 2}, "too_fast"),
])  # fmt: skip
def test_the_remedy_is_that_of_the_most_frequent_cause_and_not_of_what_follows_it(reasons, key):
    assert _remedy(Counter(reasons)) == _REMEDIES[key]


def test_without_a_known_cause_there_is_none():
    assert _remedy(Counter({"untrusted": 3})) == ""


@pytest.mark.parametrize("advice", ["", "'unit: kmh' is set: correct it"])
def test_a_yaw_rate_that_was_computed_with_the_speed_names_the_unit_of_the_speed(advice):
    rng = np.random.default_rng(3)
    rate = 0.1 * np.sin(0.03 * np.arange(4000.0))
    rates = {
        "yaw_rate": rate + 0.002 * rng.standard_normal(len(rate)),
        "accelerometer.y": 3.6 * rate + 0.002 * rng.standard_normal(len(rate)),
    }
    (found,) = gain_findings(rates, {"speed": advice} if advice else {})
    assert found.quantity == "accelerometer.y"
    assert "which looks like km/h against m/s" in found.text
    assert found.text.endswith("the unit of the speed is wrong" + (f": {advice}" if advice else ""))
    rates["gyroscope"] = rates.pop("accelerometer.y")
    (found,) = gain_findings(rates, {})
    assert "speed" not in found.text, "a gyroscope needs no speed"
