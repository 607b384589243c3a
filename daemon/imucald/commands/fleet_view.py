"""What `imucald fleet analyse` prints."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from imucald.commands.terminal import plain_console, plain_where_needed
from imucald.core.counts import counted
from imucald.fleet.analysis.remounts import why_not_known
from imucald.mount.estimate import ANGLES
from imucald.mount.mount_words import CONVENTION, UNKNOWN_HALF_DEG

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import pyarrow as pa
    from rich.table import Table

SHOWN = 10
"""Rows of each kind; the tables have all."""


def print_analysis(tables: Mapping[str, pa.Table]) -> None:
    """Print types, then what stands out."""
    plain_where_needed()
    console = plain_console()
    rows = {name.rpartition("/")[2]: table.to_pylist() for name, table in tables.items()}
    console.print(_types(rows["types"]))
    console.print(CONVENTION)
    found = [row for row in rows["remounts"] if row["found"]]
    bad = [row for row in rows["groups"] if row["verdict"] == "bad"]
    design = [row for row in rows["causes"] if row["verdict"] == "design"]
    console.print(
        f"{counted(len(rows['vehicles']), 'vehicle')}, {counted(len(rows['segments']), 'segment')}"
    )
    unknown = why_not_known(row["drives"] for row in rows["vehicles"])
    _list(
        console,
        "sensors moved between drives",
        found,
        lambda r: f"{r['vehicle']} {_turn(r)}",
        f"not known: {unknown}" if unknown else "none",
    )
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
    x, y, z = (row[f"d_{axis}_deg"] for axis in "xyz")
    return f"x {x:+.2f}, y {y:+.2f}, z {z:+.2f} deg (q {row['q']:.2g})"


def _angle(value: float, half: float | None) -> str:
    known = half is not None and half < UNKNOWN_HALF_DEG
    return f"{value:+.2f}° ±{half:.2f}°" if known else "not known"


def _types(rows: Sequence[dict[str, Any]]) -> Table:
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for title in ("type", "vehicles", "drives", "roll", "pitch", "yaw", "between vehicles x y z"):
        table.add_column(title, overflow="fold")
    for row in rows:
        spread = " ".join(f"{row[f'tau_{axis}_deg']:.2f}" for axis in "xyz")
        angles = (_angle(row[f"{a}_deg"], row[f"ci95_{a}_deg"]) for a in ANGLES)
        counts = (str(row["vehicles"]), str(row["drives"]))
        table.add_row(row["vehicle_type"], *counts, *angles, f"{spread} deg")
    return table
