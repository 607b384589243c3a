"""Units: every spelling comes out in SI; what is not a unit of the dimension is refused."""

from __future__ import annotations

import math

import pytest

from imucald.core.errors import ConfigError
from imucald.core.samples import DIMENSIONS
from imucald.inputs.units import _TABLE, Unit, find_unit, is_unit, unit_names

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
IN_WORDS = [
    (36.0, "Unit_KiloMeterPerHour", "speed", 10.0),
    (36.0, "kilometers per hour", "speed", 10.0),
    (36.0, "kilometer/hour", "speed", 10.0),
    (36.0, "kilometerperhour", "speed", 10.0),
    (36.0, "km / h", "speed", 10.0),
    (36.0, "km/std", "speed", 10.0),
    (36.0, "km^h", "speed", 10.0),
    (36.0, "km_h", "speed", 10.0),
    (36.0, "KM_H", "speed", 10.0),
    (36.0, "km-h", "speed", 10.0),
    (36.0, "km\\h", "speed", 10.0),
    (36.0, "km.h", "speed", 10.0),
    (36.0, "km/hr", "speed", 10.0),
    (36.0, "kmh", "speed", 10.0),
    (36.0, "KMH", "speed", 10.0),
    (36.0, "kms/h", "speed", 10.0),
    (36.0, "km/heure", "speed", 10.0),
    (36.0, "km/u", "speed", 10.0),
    (36.0, "KM/U", "speed", 10.0),
    (36.0, "km/t", "speed", 10.0),
    (36.0, "km/st", "speed", 10.0),
    (2.5, "mps_2", "acceleration", 2.5),
    (2.5, "mps²", "acceleration", 2.5),
    (2.5, "mps-2", "acceleration", 2.5),
    (2.5, "mps^2", "acceleration", 2.5),
    (2.5, "mps**2", "acceleration", 2.5),
    (2.5, "m_s", "speed", 2.5),
    (2.5, "ms-1", "speed", 2.5),
    (180.0, "deg_s", "angular_rate", math.pi),
    (180.0, "°_s", "angular_rate", math.pi),
    (1.5, "rad_s", "angular_rate", 1.5),
    (2.5, "m_s2", "acceleration", 2.5),
    (2.5, "m_s_2", "acceleration", 2.5),
    (2.5, "m_s^2", "acceleration", 2.5),
    (2.5, "ms2", "acceleration", 2.5),
    (36.0, "kph / km/h", "speed", 10.0),
    (2.5, "meters/sec", "speed", 2.5),
    (10.0, "yd/s", "speed", 9.144),
    (180.0, "Unit_DegreOfArcPerSecon", "angular_rate", math.pi),
    (180.0, "degrees/sec", "angular_rate", math.pi),
    (180.0, "Grad/sec", "angular_rate", math.pi),
    (180.0, "deg/sek", "angular_rate", math.pi),
    (180.0, "Degré/s", "angular_rate", math.pi),
    (180.0, "degs", "angular_rate", math.pi),
    (1.5, "radians/second", "angular_rate", 1.5),
    (180.0, "Unit_DegreOfArc", "angle", math.pi),
    (1.0, "Unit_ForceOfGravi", "acceleration", 9.80665),
    (1.0, "g's", "acceleration", 9.80665),
    (2.5, "Unit_MeterPerSeconSquar", "acceleration", 2.5),
    (2.5, "Unit_MeterPerSquareSecond", "acceleration", 2.5),
    (2.5, "m s⁻²", "acceleration", 2.5),
    (2.5, "[m/(s*s)]", "acceleration", 2.5),
    (16384.0, "g/16384", "acceleration", 9.80665),
    (180 * 16.4, "deg/s/16.4", "angular_rate", math.pi),
]


@pytest.mark.parametrize(("value", "text", "dimension", "si"), KNOWN + IN_WORDS)
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


@pytest.mark.parametrize(
    "text",
    ["km/h or mph", "kph/mph", "m/s^3", "deg/s^2", "pix/sec", "km", "Unit_NewtoMeter", "Ampere"],
)
def test_what_is_no_unit_of_motion_or_two_of_them_is_not_guessed(text):
    for dimension in ("acceleration", "angular_rate", "angle", "speed"):
        with pytest.raises(ConfigError):
            find_unit(text, dimension)


def test_a_unit_of_something_else_is_told_from_a_word_that_is_none():
    for text in ("Unit_NewtoMeter", "Nm", "rpm", "U/min", "Volts", "Unit_MinutInver", "%", "km/h"):
        assert is_unit(text), text
    for text in ("", "counts", "LSB", "Number", "Mixed", "tbd", "km/h or MPH"):
        assert not is_unit(text), text


def test_every_dimension_names_its_units():
    assert {unit.dimension for unit, _ in _TABLE} == set(DIMENSIONS)
    for dimension, row in DIMENSIONS.items():
        assert find_unit(row.unit, dimension) == Unit(dimension, 1.0), (
            "the unit of SI is one of them"
        )
        for name in unit_names(dimension):
            assert find_unit(name, dimension).dimension == dimension


def test_a_flag_takes_any_unit():
    assert find_unit("whatever", "flag").dimension == "flag"
