"""Damaged tables of a fleet: they are set aside, and what they held is evaluated again."""

from __future__ import annotations

from imucald.fleet.columns import TABLES
from imucald.fleet.store import Store
from imucald.fleet.tables import DamagedTableError, parts, read_file

ASIDE = "_damaged"
"""Folder of what is set aside; no reader of tables looks there."""


def set_damaged_aside(store: Store) -> list[str]:
    """Set damaged files of the tables aside; a line for each. Only who holds the lease may call it.

    What a file of `events` held is known by the rows of `drives` that came with it, so these are
    set aside too: `known_sources` misses them.
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
