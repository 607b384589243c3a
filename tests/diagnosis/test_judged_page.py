"""The tables of the diagnosis's judge: what is right is counted, what is missed has a row."""

from __future__ import annotations

from benchmarks.diagnosis.judged import drives


def line(log: str, *named: str) -> dict[str, object]:
    return {
        "log": log, "effect": "gyro_bias", "right": ["gyro_bias"], "verdict": "found",
        "said": list(named), "sets": [], "likely": [], "left": [],
    }  # fmt: skip


def test_a_missed_drive_has_a_row_and_a_right_one_is_counted():
    first, _, _, _, *rows = drives([line("one", "gyro_bias"), line("two", "accel_bias")], "Drives")
    assert first == "Drives: 1 of 2 right; the others:"
    assert rows == ["| two | gyro_bias | found | accel_bias | - | - | - |"]


def test_where_all_is_right_there_is_no_table():
    assert list(drives([line("one", "gyro_bias")], "Drives")) == ["Drives: 1 of 1 right."]
