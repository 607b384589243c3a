"""Raw expressions: the same number on one frame and on columns; nothing else is reachable."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imucald.core.errors import ConfigError
from imucald.inputs.expression import Expression

FRAME = bytes([0x03, 0x41, 0x0D, 0x58, 0xFF, 0x00, 0x12, 0x80])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("data[3]", 88.0),
        ("data[6] << 8 | data[7]", 0x1280),
        ("(data[6] * 256 + data[7]) / 4", 0x1280 / 4),
        ("data[3] / 2 - 40", 4.0),
        ("-data[3] + 0.5", -87.5),
        ("(data[4] & 0x0F) >> 2", 3.0),
        ("length", 8.0),
        ("data[1] == 0x41 and data[2] == 0x0D", 1.0),
        ("data[1] == 0x41 and data[2] == 0x0C", 0.0),
        ("data[1] == 0x40 or not data[5]", 1.0),
        ("7", 7.0),
    ],
)
def test_known_values(text, expected):
    expression = Expression(text)
    assert expression.number(FRAME) == expected
    column = np.frombuffer(FRAME, np.uint8)[None, :]
    assert expression.numbers(column, np.array([8], np.uint8)).tolist() == [expected]
    assert expression.holds(FRAME) == bool(expected)


def test_it_says_how_many_bytes_it_needs():
    assert Expression("data[1] == 0x41 and data[5]").needs == 6
    assert Expression("length > 3").needs == 0


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')",
        "data.__class__",
        "data[0].bit_length()",
        "(lambda: 1)()",
        "[x for x in data]",
        "data[0] ** data[1]",
        "data[0] % 3",
        "data[i]",
        "data[-1]",
        "data[64]",
        "data[True]",
        "True",
        "'a' * 9",
        "data[0] if data[1] else 2",
        "0 < data[0] < 5",
        "data",
        "open",
        "data[0] := 1",
        "",
        "(" * 400,
        "1" * 301,
        "\x00",
    ],
)
def test_anything_else_is_refused(text):
    with pytest.raises(ConfigError):
        Expression(text)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("data[0] / 0", "divisor"),
        ("data[0] / data[1]", "divisor"),
        ("data[0] << 41", "shift"),
        ("data[0] << data[1]", "shift"),
        ("data[0] << 40 << 40", "2^53"),
        ("(data[0] * 1000000 * 1000000 * 1000000)", "2^53"),
        ("(data[0] / 2) & 3", "an integer"),
        ("1.5 | data[0]", "an integer"),
    ],
)
def test_arithmetic_that_would_not_be_exact_is_refused_with_the_reason(text, reason):
    with pytest.raises(ConfigError) as error:
        Expression(text)
    assert reason in str(error.value)


BYTES = st.integers(0, 7).map(lambda i: f"data[{i}]")
WHOLE = st.recursive(
    st.one_of(BYTES, BYTES, st.integers(0, 300).map(str), st.just("length")),
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from(["+", "-", "*", "&", "|"]), inner).map(
            lambda x: f"({x[0]} {x[1]} {x[2]})"
        ),
        st.tuples(inner, st.sampled_from(["<<", ">>"]), st.integers(0, 12)).map(
            lambda x: f"({x[0]} {x[1]} {x[2]})"
        ),
    ),
    max_leaves=6,
)
NUMBER = st.one_of(
    WHOLE,
    st.tuples(
        WHOLE, st.sampled_from(["+", "-", "*", "/"]), st.sampled_from(["3", "0.1", "7.5"])
    ).map(lambda x: f"({x[0]} {x[1]} {x[2]})"),
)
TRUTH = st.tuples(NUMBER, st.sampled_from(["==", "!=", "<", "<=", ">", ">="]), NUMBER).map(
    lambda x: f"({x[0]} {x[1]} {x[2]})"
)
ANY = st.one_of(
    NUMBER,
    st.tuples(TRUTH, st.sampled_from(["and", "or"]), TRUTH).map(lambda x: f"{x[0]} {x[1]} {x[2]}"),
    TRUTH.map(lambda x: f"not {x}"),
    st.tuples(TRUTH, st.sampled_from(["+", "-", "*"]), TRUTH).map(" ".join),
    TRUTH.map(lambda x: f"-{x}"),
)


@pytest.mark.slow
@given(ANY, st.lists(st.binary(min_size=8, max_size=8), min_size=1, max_size=8))
def test_columns_equal_single_frames_and_python(text, frames):
    try:
        expression = Expression(text)
    except ConfigError as error:
        assert "2^53" in str(error)  # noqa: PT017 - the only reason that these can have
        return
    columns = np.array([list(frame) for frame in frames], np.uint8)
    lengths = np.full(len(frames), 8, np.uint8)
    single = [expression.number(frame) for frame in frames]
    assert expression.numbers(columns, lengths).tolist() == single
    assert expression.hold(columns, lengths).tolist() == [expression.holds(f) for f in frames]
    python = [float(eval(text, {"data": frame, "length": 8})) for frame in frames]
    assert single == python
