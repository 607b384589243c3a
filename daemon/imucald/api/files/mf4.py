"""MF4 (ASAM MDF 4.10): one channel group per table, a unit for each channel, one attachment."""

from __future__ import annotations

import contextlib
import json
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from imucald.api.columns import Columns, TableColumn, columns_from
from imucald.api.files.table_file import Tables, axes_of, given_up, named, unfinished
from imucald.api.interchange import library
from imucald.can.logs.untrusted_files import mf4_end
from imucald.core.errors import ImucaldError

ATTACHMENT = "imucald.json"
ENCODING = "utf-8"
SIGNATURE = b"MDF     "
"""The first bytes of every MDF file."""


class Mf4Tables:
    """Writes MF4. The master channel is `t_s`; `time` is in microseconds since 1970."""

    needs: ClassVar = ("asammdf", "mf4")

    def __init__(self, path: Path, tables: Tables) -> None:
        self._path = path
        # asammdf appends its own suffix to any other suffix
        self._saving = unfinished(path).with_suffix(".mf4")
        self._asammdf = library(*self.needs)
        self._mdf = self._asammdf.MDF(version="4.10")
        self._groups: dict[str, int] = {}

    def add_tables(self, part: Mapping[str, Columns]) -> None:
        """Append rows to each table's channel group. The first rows create the group."""
        for name, rows in part.items():
            if len(rows):
                self._append(name, rows)

    def _append(self, name: str, rows: Columns) -> None:
        arrays = [_stored(c, a) for c, a in zip(rows.columns, rows.arrays, strict=True)]
        if name in self._groups:
            self._mdf.extend(self._groups[name], [(array, None) for array in arrays])
            return
        signals = [
            self._asammdf.Signal(array, arrays[0], name=c.name, unit=_unit(c), encoding=ENCODING)
            for c, array in zip(rows.columns[1:], arrays[1:], strict=True)
        ]
        comment = f"{name}; axes: {axes_of(name)}"
        self._groups[name] = len(self._mdf.groups)
        self._mdf.append(signals, acq_name=name, comment=comment, common_timebase=True)
        master = self._mdf.groups[self._groups[name]].channels[0]
        master.name, master.unit = "t_s", "s"

    def finish(self, about: Mapping[str, Any]) -> list[Path]:
        """Write the attachment and the file."""
        start = timedelta(microseconds=about["drive"]["start_us"] or 0)
        self._mdf.header.start_time = datetime(1970, 1, 1, tzinfo=UTC) + start
        text = json.dumps({**about, "groups": self._groups}, allow_nan=False, ensure_ascii=False)
        self._mdf.attach(text.encode(), ATTACHMENT, mime="application/json")
        saved = self._mdf.save(self._saving, overwrite=True, compression=2)
        self._mdf.close()
        Path(saved).replace(unfinished(self._path))
        return [named(self._path)]

    def abandon(self) -> None:
        """Close and remove the unfinished file."""
        given_up([self._mdf], [self._saving, unfinished(self._path)])


def _unit(column: TableColumn) -> str:
    return "us" if column.kind == "time" else column.unit


def _stored(column: TableColumn, array: NDArray[Any]) -> NDArray[Any]:
    if column.kind == "text":
        return np.array([text.encode(ENCODING) for text in array.tolist()], dtype=np.bytes_)
    return array.view(np.uint8) if column.kind == "bool" else array


def _close_half_made(error: Exception) -> None:
    """Close the incomplete asammdf object of a damaged file, because its deletion would raise an
    error later."""
    for frame, _ in traceback.walk_tb(error.__traceback__):
        half_made: Any = frame.f_locals.get("self")
        with contextlib.suppress(Exception):
            half_made.close()


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Open a file. Raises ImucaldError if imucald did not write it."""
    asammdf = library(*Mf4Tables.needs)
    with path.open("rb") as file:
        if file.read(len(SIGNATURE)) != SIGNATURE:
            raise ImucaldError(f"{path}: this is not an MF4 file")
        if why := mf4_end(path):
            raise ImucaldError(f"{path}: cannot be read: {why}")
        file.seek(0)
        try:
            opening = asammdf.MDF(file, process_bus_logging=False)
        except Exception as error:
            _close_half_made(error)
            raise
        with opening as mdf:
            if not any(str(a.file_name) == ATTACHMENT for a in mdf.attachments):
                raise ImucaldError(f"{path}: was not written by imucald")
            yield mdf


def read_about(path: Path) -> dict[str, Any]:
    """Read the description of the tables from a file."""
    with opened(path) as mdf:
        (found,) = [a for a in mdf.attachments if str(a.file_name) == ATTACHMENT]
        about: dict[str, Any] = json.loads(found.extract())
    return about


def read_tables(path: Path, about: Mapping[str, Any], tables: Tables) -> dict[str, Columns]:
    """Read the tables of a file."""
    groups = about["groups"]
    with opened(path) as mdf:
        return {name: _read(mdf, groups.get(name), columns) for name, columns in tables.items()}


def _read(mdf: Any, group: int | None, columns: tuple[TableColumn, ...]) -> Columns:
    if group is None:
        return columns_from(columns, [[] for _ in columns])
    arrays: list[Any] = [mdf.get_master(group)]
    for column in columns[1:]:
        samples = mdf.get(column.name, group=group, raw=True).samples
        if column.kind == "text":
            samples = [text.decode(ENCODING) for text in samples.tolist()]
        arrays.append(samples)
    return columns_from(columns, arrays)
