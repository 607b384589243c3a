"""Set damaged tables of a fleet aside, so that their logs are evaluated again."""

from __future__ import annotations

from imucald.fleet.columns import TABLES
from imucald.fleet.store import Store
from imucald.fleet.tables import DamagedTableError, parts, read_file

ASIDE = "_damaged"
"""Folder for files that are set aside; readers of tables ignore it."""


def set_damaged_aside(store: Store) -> list[str]:
    """Set damaged files of the tables aside. Returns one line of text for each. Only the holder of
    the lease may call it.

    The rows of `drives` that came with a damaged file of `events` are set aside too. So
    `known_sources` does not find their logs, and they are evaluated again.
    """
    said = []
    for table in TABLES:
        for number, name in parts(store, table):
            try:
                read_file(store, name, TABLES[table])
            except DamagedTableError as error:
                said.append(f"{error.reason}; the file is renamed to {_set_aside(store, name)}")
                if table == "events":
                    for _, other in (p for p in parts(store, "drives") if p[0] == number):
                        _set_aside(store, other)
    return said


def _set_aside(store: Store, name: str) -> str:
    number = len(store.names(ASIDE, "")) + 1
    aside = f"{ASIDE}/{number:03}-{name.replace('/', '-')}"
    store.write(aside, store.read(name))
    store.remove(name)
    return aside
