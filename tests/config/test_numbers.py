"""Numbers of which no number can be made are refused where they stand."""

from __future__ import annotations

import pytest

from imucald.config import parse_config
from imucald.core.errors import ConfigError
from paths import ROOT

CONFIG = ROOT / "config" / "imucald.yaml"


@pytest.mark.parametrize("number", [".inf", "-.inf", ".nan", "1.0e+308", "-1.0e+200"])
def test_a_number_whose_square_is_infinite_is_refused_with_its_line(number: str) -> None:
    text = "database: car.dbc\ncalibration:\n  accelerometer_bias: " + number
    with pytest.raises(ConfigError, match=r"yaml:3: calibration\.accelerometer_bias: .* below"):
        parse_config(text, CONFIG)
