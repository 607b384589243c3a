"""`imucald fleet status`, `why`, `analyse` and `report`: evaluate the tables."""

from __future__ import annotations

import argparse
import time
from typing import TYPE_CHECKING

from imucald.core.errors import ImucaldError
from imucald.core.text import counted, duration, size

if TYPE_CHECKING:
    from imucald.fleet.store import Store


def _store(options: argparse.Namespace) -> Store:
    from imucald.fleet.fleet_file import read_settings
    from imucald.fleet.store import Store
    from imucald.fleet.tables import parts

    storage = read_settings(options.fleet)[0].storage if options.fleet else None
    store = Store(options.out, storage)
    if not parts(store, "sources"):
        raise ImucaldError(f"{store.url}: no results here yet; run 'imucald fleet run' first")
    return store


def status(options: argparse.Namespace) -> int:
    """Print the results so far, the failed logs with reasons, and whether a run is active."""
    from collections import Counter

    from rich.table import Table

    from imucald.commands.terminal import plain_console
    from imucald.fleet.compaction import read_tables
    from imucald.fleet.lease import holder_of
    from imucald.fleet.reading import mixed_words

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

    from imucald.commands.terminal import plain_console
    from imucald.fleet.compaction import read_tables

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
    from imucald.commands.fleet_view import print_analysis
    from imucald.commands.terminal import plain_console
    from imucald.fleet.analysis.analyse import GROUPS
    from imucald.fleet.compaction import read_tables
    from imucald.fleet.lease import Lease
    from imucald.fleet.reading import analyse_fleet, mixed_words

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
