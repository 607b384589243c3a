"""Print the results of `imucald fleet analyse`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from imucald.commands.terminal import plain_console, plain_where_needed
from imucald.core.text import counted
from imucald.fleet.reading import (
    no_common_mount_words,
    present_mounts,
    shown_types,
    spread_text,
    time_text,
    unordered_words,
    when_moved,
    why_not_known,
)
from imucald.mount.estimate import ANGLES
from imucald.mount.mount_words import CONVENTION, UNKNOWN_HALF_DEG

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import pyarrow as pa
    from rich.table import Table

SHOWN = 10
"""Largest number of printed rows of each kind. The files of the tables contain all rows."""


def print_analysis(tables: Mapping[str, pa.Table]) -> None:
    """Print the vehicle types, then the conspicuous results."""
    plain_where_needed()
    console = plain_console()
    rows = {name.rpartition("/")[2]: table.to_pylist() for name, table in tables.items()}
    mounts = present_mounts(rows["vehicles"], rows["segments"], rows["remounts"])
    unknown = why_not_known(rows["vehicles"])
    if mounts:
        console.print(_mounts(mounts[:SHOWN], are_moves_known=not unknown))
        if len(mounts) > SHOWN:
            console.print(f"and {len(mounts) - SHOWN} more")
        console.print()
    console.print(_types(shown_types(rows["types"])))
    console.print(CONVENTION)
    if differ := no_common_mount_words(rows["types"]):
        console.print(differ)
    found = [row for row in rows["remounts"] if row["found"]]
    bad = [row for row in rows["groups"] if row["verdict"] == "bad"]
    design = [row for row in rows["causes"] if row["verdict"] == "design"]
    console.print(
        f"{counted(len(rows['vehicles']), 'vehicle')}, {counted(len(rows['segments']), 'segment')}"
    )
    _list(
        console,
        "moves of sensors",
        found,
        lambda r: f"{r['vehicle']} {when_moved(r)}: {_turn(r)}",
        f"not known: {unknown}" if unknown else "none",
    )
    if found and unknown:
        console.print(f"  between drives: not known: {unknown}")
    if unordered := unordered_words(rows["vehicles"]):
        console.print(f"  {unordered}")
    _list(
        console, "vehicles that stand out", rows["outliers"], lambda r: f"{r['vehicle']} {_turn(r)}"
    )
    _list(console, "bad batches", bad, lambda r: f"{r['column']} {r['name']} {_turn(r)}")
    _list(
        console,
        "faults of many vehicles",
        design,
        lambda r: f"{r['vehicle_type']}: {r['cause']} ({r['vehicles_with']} of {r['vehicles']})",
    )
    _list(
        console,
        "drives never usable",
        rows["never_usable"],
        lambda r: f"{r['vehicle_type']}: {r['drives']} ({r['reason']})",
    )


def _list(
    console: Any, title: str, rows: Sequence[dict[str, Any]], text: Any, without: str = "none"
) -> None:
    console.print(f"{title}: {len(rows) or without}")
    for row in rows[:SHOWN]:
        console.print(f"  {text(row)}")
    if len(rows) > SHOWN:
        console.print(f"  and {len(rows) - SHOWN} more")


def _turn(row: dict[str, Any]) -> str:
    if row["d_x_deg"] is None:
        return "size of the move not known"
    x, y, z = (row[f"d_{axis}_deg"] for axis in "xyz")
    q = "" if row["q"] is None else f" ({_q(row['q'])})"
    return f"x {x:+.2f}, y {y:+.2f}, z {z:+.2f} deg{q}"


def _q(q: float) -> str:
    """Format the false-discovery rate. A very small rate is printed as an upper limit, because no
    model of the noise is exact enough for such a small number."""
    return "q < 1e-6" if q < 1e-6 else f"q {q:.2g}"


def _angle(value: float, half: float | None) -> str:
    known = half is not None and half < UNKNOWN_HALF_DEG
    return f"{value:+.2f}° ±{half:.2f}°" if known else "not known"


def _mounts(rows: Sequence[dict[str, Any]], are_moves_known: bool) -> Table:
    """Make the table of vehicles with their present mounts, see `present_mounts`."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for title in ("vehicle", "drives", *ANGLES, "state", "since", "moves"):
        is_text = title in ("vehicle", "state", "since")
        whole = {"since": len("2026-05-01")}.get(title)  # a date breaks before its time only
        side: Any = "left" if is_text else "right"
        table.add_column(title, justify=side, overflow="fold", min_width=whole)
    for row in rows:
        table.add_row(
            row["vehicle"],
            str(row["all_drives"]),
            *(_angle(row[f"{angle}_deg"], row[f"ci95_{angle}_deg"]) for angle in ANGLES),
            row["last_state"] or "",
            time_text(row["start"], row["first_log_key"]),
            str(row["moves"]) if row["moves"] or are_moves_known else "not known",
        )
    return table


def _types(rows: Sequence[dict[str, Any]]) -> Table:
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for title in ("type", "vehicles", "drives", "roll", "pitch", "yaw", "spread x, y, z [deg]"):
        table.add_column(title, overflow="fold")
    for row in rows:
        angles = (_angle(row[f"{a}_deg"], row[f"ci95_{a}_deg"]) for a in ANGLES)
        counts = (str(row["vehicles"]), str(row["drives"]))
        table.add_row(row["vehicle_type"], *counts, *angles, spread_text(row))
    return table
