"""Texts about moves of sensors: when they happened, and which drives could not show one."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from datetime import datetime
from typing import Any

from imucald.core.text import clock, counted
from imucald.fleet.analysis.remounts import LEAST_PAIRS

NAMED = 5
"""Largest number of vehicles named in a sentence."""
Row = Mapping[str, Any]


def names_of(rows: Iterable[Row]) -> str:
    """The vehicles of rows, each once, in order: "car-1, car-3"."""
    names = list(dict.fromkeys(str(row["vehicle"]) for row in rows))
    return ", ".join(names[:NAMED]) + (f" and {len(names) - NAMED} more" * (len(names) > NAMED))


def time_text(time: datetime | None, key: str) -> str:
    """Text of a table's time, or the key of the drive if it has no time."""
    return f"{time:%Y-%m-%d %H:%M}" if time else key


def when_moved(row: Row) -> str:
    """Text of the time when a sensor was moved. row: of `analysis/remounts`."""
    before = time_text(row["before"], row["before_log_key"])
    if row["found_s"] is None:
        return f"between {before} and {time_text(row['after'], row['after_log_key'])}"
    return f"within the drive of {before}, found after {clock(row['found_s'])}"


def why_not_known(vehicles: Iterable[Row]) -> str:
    """Reason why no move between drives could be found; "" if it could. vehicles: of
    `analysis/vehicles`."""
    pairs = sum(max(v["drives"] - 1 - v["drives_unordered"], 0) for v in vehicles)
    if pairs >= LEAST_PAIRS:
        return ""
    return (
        f"too few drives: {pairs} of the {LEAST_PAIRS} pairs of successive drives of a vehicle "
        "(with known mounts) that show how drives differ without a move"
    )


def unordered_words(vehicles: Iterable[Row]) -> str:
    """Text about the number and vehicles of drives without an order; "" if all have one.

    vehicles: rows of `analysis/vehicles`.
    """
    mine = [v for v in vehicles if v["drives_unordered"]]
    if not mine:
        return ""
    count = counted(sum(v["drives_unordered"] for v in mine), "drive")
    return (
        f"{count} without an order in time ({names_of(mine)}): overlapping an earlier drive of the "
        "vehicle, or without a time. Moves before them cannot be found. Are the loggers' clocks "
        "right?"
    )
