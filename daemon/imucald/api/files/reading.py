"""`imucald.open_result`: read the files that `write` wrote."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from imucald.api.columns import Columns
from imucald.api.configuration import PathLike
from imucald.api.drive import DriveResult, drive_from_plain
from imucald.api.files import arrow_files, mcap_log, mf4
from imucald.api.files.table_file import Tables, tables_of
from imucald.api.files.written import format_of
from imucald.core.errors import ImucaldError

Reader = Callable[[Path, Mapping[str, Any], Tables], dict[str, Columns]]


def open_result(path: PathLike) -> DriveResult:
    """Open files of `DriveResult.write` or `imucald replay --write`; return the same result.

    path: the path that was given for writing; for Parquet and CSV, any of the files.
    Raises ImucaldError if the file does not exist or if imucald did not write it.
    """
    file = Path(path)
    format_of(file)
    try:
        about, place, read = _opened(file)
        tables = tables_of(about)
        return drive_from_plain(about["drive"], read(place, about, tables))
    except ImucaldError as error:
        text = str(error)
        raise ImucaldError(text if text.startswith(str(file)) else f"{file}: {text}") from None
    except OSError as error:
        raise ImucaldError(f"{file}: cannot be opened: {error.strerror or error}") from None
    # Libraries do not document their errors for damaged files; any exception is possible.
    except Exception as error:
        raise ImucaldError(f"{file}: cannot be read: {error or type(error).__name__}") from error


def _opened(file: Path) -> tuple[dict[str, Any], Path, Reader]:
    ending = file.suffix.lower()
    if ending == ".mf4":
        return mf4.read_about(file), file, mf4.read_tables
    if ending == ".mcap":
        return mcap_log.read_about(file), file, mcap_log.read_tables
    if ending == ".parquet":
        one = file if file.exists() else _beside(file)
        return arrow_files.parquet_about(one), file.parent, arrow_files.parquet_tables
    for stem in (file.stem, file.stem.rpartition(".")[0]):
        result = file.with_name(f"{stem}.result.json")
        if stem and result.exists():
            about = json.loads(result.read_text(encoding="utf-8"))
            return about, file.parent, arrow_files.csv_tables
    raise ImucaldError(f"{file.stem}.result.json, written together with it, is missing")


def _beside(file: Path) -> Path:
    """Return any of the files that were written together under the name `file`."""
    found = sorted(file.parent.glob(f"{file.stem}.*{file.suffix}"))
    if not found:
        raise ImucaldError(f"{file}: cannot be opened: No such file or directory")
    return found[0]
