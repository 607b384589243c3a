"""`imucald.Fleet`: read the folder of a fleet in Python."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import pyarrow as pa

from imucald.core.errors import ImucaldError
from imucald.core.text import counted
from imucald.fleet.analysis.analyse import GROUPS
from imucald.fleet.analysis_columns import ANALYSIS
from imucald.fleet.columns import TABLES
from imucald.fleet.compaction import read_tables
from imucald.fleet.reading import analyse_fleet, read_analysis
from imucald.fleet.store import Store
from imucald.fleet.tables import parts


class FleetTables:
    """The tables in the folder of a fleet, as Arrow tables. Each table is read at its first use.

    Open the folder again to see the results of a later run.
    """

    def __init__(self, store: Store) -> None:
        self._store = store

    @classmethod
    def open(cls, url: str, storage: Mapping[str, Mapping[str, Any]] | None = None) -> FleetTables:
        """Open the folder that `imucald fleet run --out` wrote.

        url: a path, or any address that fsspec supports. storage: options by protocol, as in
        fleet.yaml. Raises ImucaldError if no run has written to this folder.
        """
        store = Store(str(url), storage)
        if not parts(store, "sources"):
            raise ImucaldError(f"{store.url}: no results here yet; run 'imucald fleet run' first")
        return cls(store)

    def __repr__(self) -> str:
        drives = counted(len(self.drives), "drive")
        return f"Fleet at {self._store.url}: {drives}, {len(self.failures)} failed"

    def table(self, name: str) -> pa.Table:
        """Return a table by its name, such as "sources" or "analysis/groups" (see docs/fleet.md).
        Raises ImucaldError for an unknown name, and for `analysis/...` before the fleet is
        analysed.
        """
        if name in TABLES:
            return self._read[name]
        if name in ANALYSIS:
            return self._analysis[name]
        raise ImucaldError(
            f"there is no table {name}; there are: {', '.join((*TABLES, *ANALYSIS))}"
        )

    @property
    def drives(self) -> pa.Table:
        """Table with a row for each drive."""
        return self.table("drives")

    @property
    def events(self) -> pa.Table:
        """Table of the events within drives."""
        return self.table("events")

    @property
    def failures(self) -> pa.Table:
        """Table of the failed logs with reasons."""
        return self.table("failures")

    @property
    def vehicles(self) -> pa.Table:
        """Table with a row for each vehicle. Raises ImucaldError if the fleet is not analysed
        yet."""
        return self.table("analysis/vehicles")

    def analyse(self, groups: Sequence[str] = GROUPS) -> dict[str, pa.Table]:
        """Analyse the fleet like the command `imucald fleet analyse`, write the tables, and return
        them by name.

        groups: columns of `drives`. The vehicles with the same value in such a column form a group
        that is compared with other vehicles.
        """
        self.__dict__["_analysis"] = found = analyse_fleet(self._store, groups)
        return found

    @cached_property
    def _read(self) -> dict[str, pa.Table]:
        return read_tables(self._store)

    @cached_property
    def _analysis(self) -> dict[str, pa.Table]:
        return read_analysis(self._store)
