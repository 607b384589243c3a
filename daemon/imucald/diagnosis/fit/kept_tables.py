"""Cache of tables by model file: a search returns to most of them."""

from __future__ import annotations

from collections.abc import Sequence

from imucald.diagnosis.equations.forward import Forward
from imucald.diagnosis.fit.blocks import MadeLater, Table, table_of
from imucald.diagnosis.signals import DriveSignals
from imucald.model.model import VehicleModel

MOST_BYTES = 200_000_000
"""Size limit of the kept rows and matrices: about twenty tables of half an hour."""


class KeptTables:
    """Tables of the same drives with changing model files; the last used ones are kept."""

    def __init__(self) -> None:
        self._kept: list[tuple[VehicleModel, Table, list[Forward]]] = []

    def of(
        self, drives: Sequence[DriveSignals], model: VehicleModel
    ) -> tuple[Table, list[Forward]]:
        """The table of a model file; it is made if it is not in the cache. drives: always the
        same."""
        for i, (known, table, forwards) in enumerate(self._kept):
            if known == model:
                self._kept.append(self._kept.pop(i))
                return table, forwards
        table, forwards = table_of(drives, model)
        self._kept.append((model, table, forwards))
        while len(self._kept) > 1 and sum(_nbytes(t) for _, t, _ in self._kept) > MOST_BYTES:
            self._kept.pop(0)
        return table, forwards


def _nbytes(table: Table) -> int:
    rows = table.plain.nbytes if isinstance(table.plain, MadeLater) else 0
    return rows + table.gram.nbytes
