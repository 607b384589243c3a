"""Merge the parts of a run into the finished tables. The result does not depend on the order in
which the logs were evaluated."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence

import pyarrow as pa

from imucald.fleet.columns import TABLES
from imucald.fleet.store import Store
from imucald.fleet.tables import FinishedRows, main_file, parts, read_with_parts
from imucald.fleet.task import OK


def read_tables(store: Store, names: Sequence[str] = tuple(TABLES)) -> dict[str, pa.Table]:
    """Return the tables in their present state, including the parts of a running or interrupted
    run."""
    return {name: rows.table() for name, rows in _tables(store, names)}


def _tables(store: Store, names: Sequence[str]) -> Iterator[tuple[str, FinishedRows]]:
    """Yield the tables one after the other, because all tables together may need too much
    memory."""
    sources, numbers = read_with_parts(store, "sources")
    last = _last(sources.column("source").to_pylist(), numbers)
    outcomes = FinishedRows("sources", sources, last)
    if "sources" in names:
        yield "sources", outcomes
    sources = sources.select(["source", "log_key", "outcome"]).take(pa.array(last, pa.int64()))
    del outcomes, numbers, last
    if "failures" in names:
        yield "failures", _failures(store, sources)
    if "drives" in names or "events" in names:
        drives, of_drive = _drives(store, sources)
        del sources
        if "drives" in names:
            yield "drives", drives
        del drives
        if "events" in names:
            yield "events", _events(store, of_drive)
        del of_drive
    if "costs" in names:
        yield "costs", FinishedRows("costs", read_with_parts(store, "costs")[0])


def compact(store: Store) -> None:
    """Write the finished tables, and delete the parts from which they were made."""
    old = {name: [file for n, file in parts(store, name) if n > 0] for name in TABLES}
    if not any(old.values()):
        return
    for name, rows in _tables(store, tuple(TABLES)):
        store.write(main_file(name), rows.parquet())
        del rows
        pa.default_memory_pool().release_unused()
    # drives first, sources last: after an interruption the remaining files still give the same
    # tables
    for name in ("drives", "events", "failures", "costs", "sources"):
        for file in old[name]:
            store.remove(file)


def _last(keys: Sequence[object], numbers: Sequence[int]) -> list[int]:
    """Return the index of the valid row for each key: the last row with the highest flush
    number."""
    best: dict[object, int] = {}
    for index, key in enumerate(keys):
        if key not in best or numbers[index] >= numbers[best[key]]:
            best[key] = index
    return list(best.values())


def _failures(store: Store, sources: pa.Table) -> FinishedRows:
    rows, numbers = read_with_parts(store, "failures")
    outcome = dict(
        zip(
            sources.column("source").to_pylist(),
            sources.column("outcome").to_pylist(),
            strict=True,
        )
    )
    names = rows.column("source").to_pylist()
    kept = [i for i in _last(names, numbers) if outcome.get(names[i], OK) != OK]
    return FinishedRows("failures", rows, kept)


def _drives(
    store: Store, sources: pa.Table
) -> tuple[FinishedRows, dict[str, tuple[int, str | None]]]:
    """Return the valid rows of drives. The second result contains for each log_key the flush number
    and the vehicle of its row."""
    addresses: dict[str, list[str]] = {}
    columns = (sources.column(name).to_pylist() for name in ("source", "log_key", "outcome"))
    for source, key, outcome in zip(*columns, strict=True):
        if outcome == OK and key is not None:
            addresses.setdefault(key, []).append(source)
    rows, numbers = read_with_parts(store, "drives")
    keys = rows.column("log_key").to_pylist()
    firsts = [json.loads(text)[0] for text in rows.column("sources").to_pylist()]
    known = [(key, first) for key, first in zip(keys, firsts, strict=True)]
    chosen: dict[str, int] = {}
    for index in _last(known, numbers):
        key = keys[index]
        # of several rows for one drive, the one with the first address in sorted order counts
        if key in addresses and (key not in chosen or firsts[index] < firsts[chosen[key]]):
            chosen[key] = index
    lists = [json.dumps(sorted(addresses[key]), ensure_ascii=False) for key in chosen]
    kept = FinishedRows("drives", rows, list(chosen.values()), {"sources": lists})
    vehicles = rows.column("vehicle").to_pylist()
    return kept, {key: (numbers[i], vehicles[i]) for key, i in chosen.items()}


def _events(store: Store, of_drive: dict[str, tuple[int, str | None]]) -> FinishedRows:
    """Return the events that were written in the same flush as the valid rows of drives."""
    rows, numbers = read_with_parts(store, "events")
    keys = rows.column("log_key").to_pylist()
    came = {key: number for key, (number, _) in of_drive.items()}
    kept = [i for i, k in enumerate(keys) if came.get(k) == numbers[i]]
    vehicles = [of_drive[keys[i]][1] for i in kept]
    return FinishedRows("events", rows, kept, {"vehicle": vehicles})
