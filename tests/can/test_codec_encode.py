"""Encode plans: rounding, ranges, not-available values, start values, multiplexers."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imucald.can.dbc.database import Database, load_database, load_database_text
from imucald.can.dbc.decode import compile_decode
from imucald.can.dbc.encode import EncodePlan, compile_encode
from imucald.can.dbc.message import Message
from imucald.core.errors import DatabaseError, EncodeError
from paths import ROOT

DATA = ROOT / "tests" / "data"
ABSENT = {"AX": -32768, "AY": -32768, "AZ": 4095}


@pytest.fixture(scope="module")
def database() -> Database:
    return load_database(DATA / "cluster.dbc")


@pytest.fixture(scope="module")
def imu(database: Database) -> Message:
    return database.message("IMU")


def both(plan: EncodePlan, row: list[float | None]) -> bytes:
    """Encode one frame both ways; they must agree."""
    one = plan.encode(row)
    columns = [np.array([math.nan if v is None else v]) for v in row]
    assert plan.encode_columns(columns)[0].tobytes() == one
    return one


def one_signal(line: str, more: str = "") -> Message:
    head = 'VERSION ""\nNS_ :\nBS_:\nBU_:\nBO_ 16 M: 8 Vector__XXX\n'
    return load_database_text(f"{head} SG_ S : {line} Vector__XXX\n{more}", "dbc").message("M")


@pytest.mark.parametrize(
    ("value", "raw"),
    [(0.5, 0), (1.5, 2), (2.5, 2), (-0.5, 0), (-1.5, -2), (126.5, 126), (-128.5, -128)],
)
def test_halves_are_rounded_to_even(value: float, raw: int) -> None:
    plan = compile_encode(one_signal('0|8@1- (1,0) [0|0] ""'), ["S"])
    assert both(plan, [value])[0] == raw & 0xFF


def test_what_a_signal_cannot_say_becomes_not_available(imu: Message) -> None:
    plan = compile_encode(imu, ["AX", "AY", "AZ"], ABSENT)
    decode = compile_decode(imu, ["AX", "AY", "AZ"])
    for bad in (math.nan, math.inf, -math.inf, 65.54, -65.54, 1e300, -1e300):
        assert decode.decode_raw(both(plan, [bad, bad, 0.0])) == (-32768, -32768, 2000)
    assert decode.decode_raw(both(plan, [None, 1.0, None])) == (-32768, 500, 4095)


def test_without_a_not_available_value_it_is_an_error(imu: Message) -> None:
    plan = compile_encode(imu, ["AX", "AY"], {"AX": -32768})
    assert both(plan, [None, 0.0])
    for bad in (math.nan, math.inf, 65.54, 1e300):
        with pytest.raises(EncodeError, match=r"IMU\.AY"):
            plan.encode([0.0, bad])
        with pytest.raises(EncodeError, match=r"IMU\.AY"):
            plan.encode_columns([np.zeros(3), np.array([0.0, bad, 0.0])])
    with pytest.raises(EncodeError):
        plan.encode([0.0, None])


def test_the_stated_range_holds_to_half_a_step(imu: Message) -> None:
    plan = compile_encode(imu, ["AX"], ABSENT)
    decode = compile_decode(imu, ["AX"])
    assert decode.decode_raw(both(plan, [65.5349])) == (32767,)  # 65.534 is stated
    assert decode.decode_raw(both(plan, [65.5351])) == (-32768,)
    assert decode.decode_raw(both(plan, [-65.534])) == (-32767,)


def test_the_rounding_of_a_stated_range_takes_nothing_away() -> None:
    # 0.3 / 0.1 is a little less than 3 in doubles
    plan = compile_encode(one_signal('0|8@1- (0.1,0) [-0.3|0.3] ""'), ["S"], {"S": 100})
    assert [both(plan, [v])[0] for v in (0.3, -0.3, 0.4)] == [3, 253, 100]


def test_a_negative_factor_keeps_its_range() -> None:
    plan = compile_encode(one_signal('0|8@1+ (-2,10) [-100|4] ""'), ["S"], {"S": 255})
    assert both(plan, [4.0])[0] == 3
    assert both(plan, [6.0])[0] == 255
    assert both(plan, [-100.0])[0] == 55
    assert both(plan, [-102.0])[0] == 255


def test_signals_that_are_not_given_hold_their_start_value(imu: Message) -> None:
    plan = compile_encode(imu, ["AY"])
    decode = compile_decode(imu, ["AX", "AY", "AZ", "ALIVE"])
    assert decode.decode_raw(both(plan, [0.002])) == (-32768, 1, 2000, 0)


def test_multiplexers_stand_where_the_signals_need_them(database: Database) -> None:
    message = database.message("STATUS")
    decode = compile_decode(message, ["PAGE", "SUPPLY", "HOURS", "SUB", "BOOTS", "ALWAYS"])
    found = decode.decode(both(compile_encode(message, ["SUPPLY", "HOURS"]), [12.0, 7.0]))
    assert found == (1.0, 12.0, 7.0, None, None, 165.0)
    found = decode.decode(both(compile_encode(message, ["SUPPLY"], multiplexer={"PAGE": 4}), [1.0]))
    assert found == (4.0, 1.0, None, None, None, 165.0)
    found = decode.decode(both(compile_encode(message, ["BOOTS"]), [9.0]))
    assert found == (2.0, None, None, 5.0, 9.0, 165.0)


def test_start_values_are_those_of_the_multiplexer_value_that_stands(database: Database) -> None:
    message = database.message("STATUS")
    decode = compile_decode(message, ["PAGE", "TEMPERATURE", "SUPPLY", "SUB", "BOOTS", "ALWAYS"])
    expected = {
        0: (0.0, 32.0, None, None, None, 1.0),
        1: (1.0, None, 5.0, None, None, 1.0),
        2: (2.0, None, None, 0.0, None, 1.0),
    }
    for page, found in expected.items():
        plan = compile_encode(message, ["ALWAYS"], multiplexer={"PAGE": page})
        assert decode.decode(both(plan, [1.0])) == found
    assert decode.decode(both(compile_encode(message, ["ALWAYS"]), [1.0])) == expected[0]
    assert both(compile_encode(message, ["ALWAYS"], multiplexer={"PAGE": 2}), [1.0])[1:3] == b"\0\0"


def test_signals_that_exclude_one_another_are_refused(database: Database) -> None:
    message = database.message("STATUS")
    with pytest.raises(DatabaseError, match="different values of PAGE"):
        compile_encode(message, ["TEMPERATURE", "SUPPLY"])
    with pytest.raises(DatabaseError, match="different values of PAGE"):
        compile_encode(message, ["SUPPLY"], multiplexer={"PAGE": 0})
    with pytest.raises(DatabaseError, match="PAGE is a multiplexer"):
        compile_encode(message, ["PAGE", "SUPPLY"])
    with pytest.raises(DatabaseError, match="given twice"):
        compile_encode(message, ["ALWAYS", "ALWAYS"])


def test_floats_are_written_as_ieee_754(database: Database) -> None:
    absent = {"SINGLE": math.nan, "DOUBLE": math.nan, "HALF": math.nan}
    plan = compile_encode(database.message("FLOATS"), ["SINGLE", "DOUBLE", "HALF"], absent)
    payload = both(plan, [0.1, -4.0, 1.5])
    assert struct.unpack("<f", payload[0:4])[0] == np.float32(0.1)
    assert struct.unpack(">d", payload[4:12]) == (-2.5,)
    for bad in (math.nan, math.inf, 1e39):  # 1e39 is beyond 32 bits, and 1e5 beyond 16
        found = compile_decode(database.message("FLOATS"), ["SINGLE", "HALF"]).decode(
            both(plan, [bad, 0.0, 1e5])
        )
        assert all(v is not None and math.isnan(v) for v in found)
    strict = compile_encode(database.message("FLOATS"), ["SINGLE"])
    for bad in (math.nan, 1e39):
        with pytest.raises(EncodeError):
            strict.encode([bad])
        with pytest.raises(EncodeError):
            strict.encode_columns([np.array([bad])])


@pytest.mark.parametrize("bits", [32, 64])
def test_a_raw_float_that_overflows_is_not_available(bits: int) -> None:
    kind = f"SIG_VALTYPE_ 16 S : {bits // 32};\n"
    message = one_signal(f'0|{bits}@1- (1e-6,0) [0|0] ""', kind)
    plan = compile_encode(message, ["S"], {"S": math.nan})
    for value in (1e308, -1e308, 1e303):
        assert math.isnan(compile_decode(message, ["S"]).decode(both(plan, [value]))[0] or 0.0)


def test_a_not_available_value_must_fit_its_bits(imu: Message) -> None:
    assert compile_encode(imu, ["AX"], {"AX": 0x8000}).encode([None])[:2] == b"\x00\x80"
    for raw in (0x10000, -0x8001, 0.5, math.nan):
        with pytest.raises(DatabaseError, match="needs more bits than the signal has"):
            compile_encode(imu, ["AX"], {"AX": raw})


def test_a_wrong_number_of_values_is_refused(imu: Message) -> None:
    plan = compile_encode(imu, ["AX", "AY"])
    for values in ([], [1.0], [1.0, 2.0, 3.0]):
        with pytest.raises(EncodeError, match="for 2 signals"):
            plan.encode(values)
        with pytest.raises(EncodeError, match="for 2 signals"):
            plan.encode_columns(values)
    with pytest.raises(EncodeError, match="differ in length"):
        plan.encode_columns([np.zeros(2), np.zeros(3)])


@settings(deadline=None)
@given(
    rows=st.lists(
        st.tuples(*[st.floats(width=64, allow_nan=True) | st.none()] * 3), min_size=1, max_size=8
    ),
)
def test_any_value_at_all_gives_the_same_bytes_both_ways(
    imu_rows_database: Database, rows: list[tuple[float | None, float | None, float | None]]
) -> None:
    plan = compile_encode(imu_rows_database.message("IMU"), ["AX", "AY", "AZ"], ABSENT)
    one_by_one = [plan.encode(row) for row in rows]
    columns = [np.array([math.nan if r[i] is None else r[i] for r in rows]) for i in range(3)]
    assert [c.tobytes() for c in plan.encode_columns(columns)] == one_by_one


@pytest.fixture(scope="module")
def imu_rows_database() -> Database:
    return load_database(DATA / "cluster.dbc")


@pytest.mark.parametrize("line", ['0|64@1+ (1,0) [0|0] ""', '7|64@0- (1,0) [0|0] ""'])
def test_sixty_four_bits_stop_at_their_ends(line: str) -> None:
    plan = compile_encode(one_signal(line), ["S"], {"S": 5})
    signed = "- " in line
    top = 2.0**63 if signed else 2.0**64
    order = "big" if line.startswith("7") else "little"
    assert int.from_bytes(both(plan, [top]), order) == 5
    below = math.nextafter(top, 0.0)
    assert int.from_bytes(both(plan, [below]), order, signed=signed) == int(below)
    assert int.from_bytes(both(plan, [-top]), order, signed=True) == (int(-top) if signed else 5)
