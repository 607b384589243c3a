"""Conversions: unit, sign, offset, and the reasons for which a number is no number."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imucald.core.samples import ACCEL
from imucald.inputs.conversion import REASONS, Conversion
from imucald.inputs.units import Unit, find_unit

KMH = find_unit("km/h", "speed")
G = find_unit("g", "acceleration")
FLAG = find_unit("", "flag")


def code_of(conversion: Conversion, physical: float, raw: float = 0) -> str:
    return REASONS[conversion.scalar(raw, physical)[1]]


def test_offset_is_in_the_unit_of_the_source_and_the_sign_comes_last():
    value, code = Conversion(KMH, sign=-1.0, offset=3.6).scalar(0, 36.0)
    assert code == 0
    assert value == pytest.approx(-11.0)


def test_unit_offset_of_temperatures():
    assert Conversion(find_unit("degF", "temperature")).scalar(0, 212.0)[0] == pytest.approx(100.0)


def test_not_available_is_judged_by_the_raw_value():
    conversion = Conversion(KMH, not_available=(255, 254))
    assert code_of(conversion, 25.5, 255) == "not_available"
    assert code_of(conversion, 255.0, 25) == ""


@pytest.mark.parametrize("physical", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_rejected(physical):
    assert code_of(Conversion(KMH), physical) == "not_finite"
    assert code_of(Conversion(FLAG), physical) == "not_finite"


def test_range_includes_its_ends_and_rails_are_saturated():
    conversion = Conversion(G, low=-1.0, high=2.0, rails=(-2.0, 2.0))
    assert code_of(conversion, -1.0) == ""
    assert code_of(conversion, math.nextafter(-1.0, -2)) == "out_of_range"
    assert code_of(conversion, 2.0) == "saturated"
    assert code_of(conversion, -2.0) == "saturated"
    assert code_of(conversion, math.nextafter(2.0, 0)) == ""


def test_beyond_any_vehicle_is_out_of_range():
    assert code_of(Conversion(KMH), 3.6 * 149.0) == ""
    assert code_of(Conversion(KMH), 3.6 * 151.0) == "out_of_range"
    assert ACCEL.largest >= 16 * 9.81


@pytest.mark.parametrize(
    ("conversion", "physical", "expected"),
    [
        (Conversion(FLAG), 0.0, 0.0),
        (Conversion(FLAG), 0.5, 1.0),
        (Conversion(FLAG, on_values=(2.0, 7.0)), 7.0, 1.0),
        (Conversion(FLAG, on_values=(2.0, 7.0)), 1.0, 0.0),
        (Conversion(FLAG, on_above=2.0), 2.0, 0.0),
        (Conversion(FLAG, on_above=2.0), 2.1, 1.0),
    ],
)
def test_flags(conversion, physical, expected):
    assert conversion.scalar(0, physical) == (expected, 0)


NUMBERS = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True), st.sampled_from([-2.0, 2.0, 0.0, -0.0, 100.0])
)


@given(
    st.lists(st.tuples(st.integers(-3, 3), NUMBERS), min_size=1, max_size=20),
    st.sampled_from([KMH, G, FLAG, Unit("temperature", 5 / 9, -160 / 9)]),
    st.sampled_from([-1.0, 1.0]),
    st.floats(-10, 10),
    st.sampled_from([(-math.inf, math.inf), (-2.0, 2.0)]),
    st.sampled_from([None, (-2.0, 2.0), (-1e300, 50.0)]),
    st.sampled_from([None, (2.0, 100.0)]),
    st.sampled_from([None, 1.0]),
)
def test_columns_give_the_same_bits_as_single_numbers(
    numbers, unit, sign, offset, limits, rails, on_values, on_above
):
    conversion = Conversion(unit, sign, offset, *limits, rails, (-1, 3), on_values, on_above)
    raw = np.array([r for r, _ in numbers])
    physical = np.array([p for _, p in numbers])
    values, codes = conversion.array(raw, physical)
    single = [conversion.scalar(r, p) for r, p in numbers]
    assert codes.tolist() == [code for _, code in single]
    assert values.tobytes() == np.array([value for value, _ in single]).tobytes()
