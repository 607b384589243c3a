"""`imucald fleet status`, `why`, `analyse` and `report`: evaluate the tables."""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rich.table import Table

from imucald.commands.terminal import plain_console, plain_where_needed
from imucald.core.errors import ImucaldError
from imucald.core.text import counted, duration, size
from imucald.fleet.compaction import read_tables
from imucald.fleet.fleet_file import read_settings
from imucald.fleet.lease import Lease, holder_of
from imucald.fleet.reading import (
    analyse_fleet,
    mixed_words,
    no_common_mount_words,
    present_mounts,
    shown_types,
    spread_text,
    time_text,
    unordered_words,
    when_moved,
    why_not_known,
)
from imucald.fleet.store import Store
from imucald.fleet.tables import parts
from imucald.mount.estimate import ANGLES
from imucald.mount.mount_words import CONVENTION, UNKNOWN_HALF_DEG

if TYPE_CHECKING:
    import pyarrow as pa


SHOWN = 10
"""Largest number of printed rows of each kind. The files of the tables contain all rows."""


def _store(options: argparse.Namespace) -> Store:

    storage = read_settings(options.fleet)[0].storage if options.fleet else None
    store = Store(options.out, storage)
    if not parts(store, "sources"):
        raise ImucaldError(f"{store.url}: no results here yet; run 'imucald fleet run' first")
    return store


def status(options: argparse.Namespace) -> int:
    """Print the results so far, the failed logs with reasons, and whether a run is active."""

    store = _store(options)
    tables = read_tables(store, ("sources", "failures", "drives", "costs"))
    console = plain_console()
    holder = holder_of(store)
    if holder is not None:
        age = time.time() - holder.beat
        console.print(
            f"a run is active: process {holder.pid} on {holder.host}, last sign of life {age:.0f} "
            "s ago"
        )
    drives, failures = tables["drives"], tables["failures"]
    sources = tables["sources"]
    read = sum(sources.column("bytes").to_pylist())
    hours = sum(d or 0.0 for d in drives.column("duration_s").to_pylist()) / 3600.0
    cpu = sum(c or 0.0 for c in tables["costs"].column("cpu_s").to_pylist())
    console.print(
        f"{counted(len(sources), 'log')}, {size(read)}: {counted(len(drives), 'drive')} of "
        f"{counted(len(set(drives.column('vehicle').to_pylist())), 'vehicle')}, "
        f"{hours:.1f} h of driving, "
        f"{duration(cpu)} of processor time"
    )
    if mixed := mixed_words(drives):
        console.print(mixed)
    states = Counter(drives.column("state").to_pylist())
    console.print("states: " + (", ".join(f"{s} {n}" for s, n in states.most_common()) or "none"))
    if len(failures):
        table = Table(box=None, pad_edge=False)
        for title in ("failure", "logs", "for example"):
            table.add_column(title, overflow="fold")
        kinds = failures.column("kind").to_pylist()
        messages = failures.column("message").to_pylist()
        for kind, n in Counter(kinds).most_common():
            table.add_row(kind, str(n), messages[kinds.index(kind)])
        console.print(table)
    return 0


def why(options: argparse.Namespace) -> int:
    """Print all values that the tables contain for one log."""
    import pyarrow.compute as pc

    store = _store(options)
    tables = read_tables(store)
    console = plain_console()
    sources = tables["sources"]
    fits = pc.or_(
        pc.match_substring(sources.column("source"), options.log),
        pc.fill_null(pc.equal(sources.column("log_key"), options.log), False),
    )
    found = sources.filter(fits).to_pylist()
    if not found:
        raise ImucaldError(f"{options.log}: no log of this fleet has this address or key")
    if len(found) > 1:
        names = "\n  ".join(row["source"] for row in found[:20])
        raise ImucaldError(
            f"{options.log}: {len(found)} logs match; give more of the address:\n  {names}"
        )
    wanted = {"source": found[0]["source"], "log_key": found[0]["log_key"]}
    for name, table in tables.items():
        key = "log_key" if name in ("drives", "events") else "source"
        if wanted[key] is None:
            continue
        for row in table.filter(pc.equal(table.column(key), wanted[key])).to_pylist():
            console.print(f"{name}:")
            for column, value in row.items():
                if value is not None:
                    console.print(f"  {column}: {value}", soft_wrap=True)
    return 0


def analyse(options: argparse.Namespace) -> int:
    """Analyse all drives together, write `analysis/`, and print the most important results."""
    from imucald.fleet.analysis.analyse import GROUPS

    store = _store(options)
    with Lease(store):
        tables = analyse_fleet(store, tuple(options.group) or GROUPS)
    print_analysis(tables)
    if mixed := mixed_words(read_tables(store, ("drives",))["drives"]):
        plain_console().print(mixed)
    return 0


def report(options: argparse.Namespace) -> int:
    """Write the HTML page about the fleet."""
    from imucald.commands.files import check_files, write_text
    from imucald.fleet.page import fleet_page

    check_files((), (options.html,))
    store = _store(options)
    write_text(options.html, fleet_page(store))
    print(f"{options.html}: written")
    return 0


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

    table = Table(box=None, pad_edge=False)
    for title in ("type", "vehicles", "drives", "roll", "pitch", "yaw", "spread x, y, z [deg]"):
        table.add_column(title, overflow="fold")
    for row in rows:
        angles = (_angle(row[f"{a}_deg"], row[f"ci95_{a}_deg"]) for a in ANGLES)
        counts = (str(row["vehicles"]), str(row["drives"]))
        table.add_row(row["vehicle_type"], *counts, *angles, spread_text(row))
    return table
