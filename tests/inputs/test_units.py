"""Units: every spelling comes out in SI; what is not a unit of the dimension is refused."""

from __future__ import annotations

import math

import pytest

from imucald.core.errors import ConfigError
from imucald.inputs.units import DIMENSIONS, find_unit, unit_names

# value in the unit, dimension, the same in SI (from the units' definitions)
KNOWN = [
    (1.0, "g", "acceleration", 9.80665),
    (1.0, "G", "acceleration", 9.80665),
    (1000.0, "mg", "acceleration", 9.80665),
    (2.5, "m/s^2", "acceleration", 2.5),
    (2.5, "m/s²", "acceleration", 2.5),
    (2.5, "m/s2", "acceleration", 2.5),
    (10.0, "ft/s^2", "acceleration", 3.048),
    (180.0, "deg/s", "angular_rate", math.pi),
    (180.0, "°/s", "angular_rate", math.pi),
    (180.0, "dps", "angular_rate", math.pi),
    (180.0, "Deg/s", "angular_rate", math.pi),
    (1.5, "rad/s", "angular_rate", 1.5),
    (180.0, "deg", "angle", math.pi),
    (180.0, "°", "angle", math.pi),
    (2.0, "rad", "angle", 2.0),
    (36.0, "km/h", "speed", 10.0),
    (36.0, "kph", "speed", 10.0),
    (36.0, "KPH", "speed", 10.0),
    (1.0, "mph", "speed", 0.44704),
    (3600.0, "knots", "speed", 1852.0),
    (50.0, "µT", "magnetic_field", 50e-6),
    (50.0, "uT", "magnetic_field", 50e-6),
    (500.0, "mG", "magnetic_field", 50e-6),
    (25.0, "°C", "temperature", 25.0),
    (298.15, "K", "temperature", 25.0),
    (77.0, "°F", "temperature", 25.0),
]


@pytest.mark.parametrize(("value", "text", "dimension", "si"), KNOWN)
def test_a_value_comes_out_in_si(value, text, dimension, si):
    unit = find_unit(f" {text} ", dimension)
    assert unit.dimension == dimension
    assert unit.factor * value + unit.offset == pytest.approx(si, rel=1e-12)


def test_milligauss_and_milli_g_are_distinguished_by_the_quantity():
    assert find_unit("mG", "magnetic_field").factor == pytest.approx(1e-7)
    assert find_unit("mg", "acceleration").factor == pytest.approx(9.80665e-3)


@pytest.mark.parametrize(
    ("text", "dimension"), [("km/h", "acceleration"), ("deg", "angular_rate"), ("furlong", "speed")]
)
def test_a_unit_of_another_dimension_is_refused_with_the_known_ones(text, dimension):
    with pytest.raises(ConfigError) as error:
        find_unit(text, dimension)
    assert repr(text) in str(error.value)
    for name in unit_names(dimension):
        assert name in str(error.value)


def test_every_dimension_names_its_units():
    for dimension in DIMENSIONS:
        for name in unit_names(dimension):
            assert find_unit(name, dimension).dimension == dimension


def test_a_flag_takes_any_unit():
    assert find_unit("whatever", "flag").dimension == "flag"
