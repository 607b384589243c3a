"""What a sensor says of itself: names in the value table, and a status signal."""

from __future__ import annotations

import numpy as np
import pytest

from engine_bus import DBC, columns_of, frames_of, load
from imucald.core.errors import ConfigError
from imucald.inputs.settings_of_signals import is_no_value
from imucald.inputs.wiring import compile_router
from imucald.runtime.session import make_engine

TABLES = (
    DBC
    + """VAL_ 352 G 0 "park" 1 "reverse" 14 "Error" 15 "SNA" ;
VAL_ 272 BX -32768 "Signal_NotAvailable" -32767 "Init" 32767 "maximum" ;
"""
)
ACCEL = "accelerometer: {x: ACC_XY.BX, y: ACC_XY.BY, z: ACC_Z.BZ}"
STATUS = """
database: bus.dbc
signals:
  accelerometer:
    x: {signal: ACC.AX, valid_when: {signal: ACRC, equals: [0, 3]}}
    y: ACC.AY
    z: ACC.AZ
"""


@pytest.mark.parametrize(
    "name",
    [
        "SNA", "sna", "Not available", "NotAvailable", "NOT_AVAILABLE", "Signal not available",
        "Invalid", "Signal_Invalid", "Error", "Error indicator", "Init", "INIT_VALUE",
        "Initialisation", "initializing", "Ungueltig", "nicht_verfuegbar", "Fehler",
    ],
)  # fmt: skip
def test_names_that_say_that_there_is_no_value(name: str) -> None:
    assert is_no_value(name)


@pytest.mark.parametrize(
    "name",
    [
        "ok",
        "No error",
        "no_fault",
        "not in error",
        "valid",
        "maximum",
        "Finite",
        "minit",
        "kein Fehler",
    ],
)
def test_names_that_do_not(name: str) -> None:
    assert not is_no_value(name)


def gear(value_table: str, tmp_path) -> list[object]:
    reverse = f"reverse: {{signal: GEAR.G, equals: [1, 15]{value_table}}}"
    text = f"database: bus.dbc\nsignals:\n  {ACCEL}\n  {reverse}\n"
    router = compile_router(load(text, tmp_path, TABLES))
    return [(router.frame(0.1 * i, 0x160, bytes([g]))) for i, g in enumerate((0, 1, 14, 15))]


def test_a_raw_value_that_the_table_calls_none_is_not_available(tmp_path) -> None:
    found = gear("", tmp_path)
    assert found == [
        ([("reverse", [0.0])], [], []),
        ([("reverse", [1.0])], [], []),
        ([], ["reverse"], ["reverse"]),
        ([], ["reverse"], ["reverse"]),
    ]


def test_a_key_switches_that_off(tmp_path) -> None:
    found = gear(", value_table: false", tmp_path)
    assert [samples[0][1] for samples, *_ in found] == [[0.0], [1.0], [0.0], [1.0]]


def accel_frames() -> list[tuple[float, int, bytes]]:
    axes = np.array([100, -50, 4900], "<i2").tobytes() + bytes(1)
    return [(0.01 * i, 0x100, axes + bytes([status])) for i, status in enumerate([0, 1, 3, 255, 0])]


def test_what_the_status_does_not_vouch_for_is_rejected_live_and_by_columns(tmp_path) -> None:
    loaded = load(STATUS, tmp_path)
    engine, other = make_engine(loaded), make_engine(loaded)
    live = [out for frame in accel_frames() for out in engine.frame(*frame)]
    assert engine.router.rejected == {"status": 2}
    assert engine.router.sample_counts["accel"] == 3
    assert frames_of(other.columns(columns_of(accel_frames()))) == live
    assert other.router.rejected == {"status": 2}


def test_a_status_of_another_message_is_refused_with_its_line(tmp_path) -> None:
    with pytest.raises(ConfigError, match=r"valid_when\.signal.*ACC has no signal 'GCNT'"):
        compile_router(load(STATUS.replace("ACRC", "GCNT"), tmp_path))
