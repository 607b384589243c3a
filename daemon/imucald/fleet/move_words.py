"""Texts about moves of sensors: when a move happened, and in which drives a move could not be
found."""

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
    """Return the names of the vehicles in rows, each once, in order: "car-1, car-3"."""
    names = list(dict.fromkeys(str(row["vehicle"]) for row in rows))
    return ", ".join(names[:NAMED]) + (f" and {len(names) - NAMED} more" * (len(names) > NAMED))


def time_text(time: datetime | None, key: str) -> str:
    """Return a time from a table as text, or `key` (the key of the drive) if there is no time."""
    return f"{time:%Y-%m-%d %H:%M}" if time else key


def when_moved(row: Row) -> str:
    """Return a text about the time when a sensor was moved. row: row of `analysis/remounts`."""
    before = time_text(row["before"], row["before_log_key"])
    if row["found_s"] is None:
        return f"between {before} and {time_text(row['after'], row['after_log_key'])}"
    return f"within the drive of {before}, found after {clock(row['found_s'])}"


def why_not_known(vehicles: Iterable[Row]) -> str:
    """Return the reason why moves between drives could not be found; "" if they could be found.
    vehicles: rows of `analysis/vehicles`."""
    pairs = sum(max(v["drives"] - 1 - v["drives_unordered"], 0) for v in vehicles)
    if pairs >= LEAST_PAIRS:
        return ""
    return (
        f"too few drives: {pairs} of the {LEAST_PAIRS} pairs of successive drives of a vehicle "
        "(with known mounts) that show how drives differ without a move"
    )


def unordered_words(vehicles: Iterable[Row]) -> str:
    """Return a text about drives without an order (their number and vehicles); "" if all drives
    have an order.

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
