"""Move damaged tables of a fleet to another folder, so that their logs are evaluated again."""

from __future__ import annotations

from imucald.fleet.columns import TABLES
from imucald.fleet.store import Store
from imucald.fleet.tables import DamagedTableError, parts, read_file

ASIDE = "_damaged"
"""Folder for damaged files. Readers of tables ignore this folder."""


def set_damaged_aside(store: Store) -> list[str]:
    """Move damaged files of the tables to the folder `ASIDE`. Return one line of text for each
    file. Only the holder of the lease may call this function.

    If a file of `events` is damaged, the rows of `drives` from the same flush are moved too. Then
    `known_sources` does not find the logs of these rows, and the logs are evaluated again.
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
