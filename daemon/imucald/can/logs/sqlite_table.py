"""Check whether the messages of an SQLite log are stored rows.

A view, a virtual table or a generated column is computed while it is read. A file of 4 kB can then
produce endless rows, or one row of a gigabyte.
"""

from __future__ import annotations

import contextlib
import sqlite3
from pathlib import Path

_TABLE = "messages"
"""The table's name, as python-can's SqliteWriter writes it."""


def why_not_stored(path: Path) -> str | None:
    """Return why the messages cannot be read. None if they are a plain table. Missing parts also
    give None, because the reader reports them."""
    with contextlib.closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as db:
        try:
            found = db.execute(
                "SELECT type, sql FROM sqlite_master WHERE lower(name) = ?", (_TABLE,)
            ).fetchall()
            kinds = [kind for kind, _ in found if kind in ("table", "view")]
            if not kinds:
                return None
            is_virtual = any(str(sql).upper().startswith("CREATE VIRTUAL") for _, sql in found)
            if kinds != ["table"] or is_virtual:
                return f"'{_TABLE}' is not a plain table"
            columns = db.execute(f"PRAGMA table_xinfo({_TABLE})").fetchall()
        except sqlite3.Error as error:
            return str(error)
    computed = [str(name) for _, name, *_, hidden in columns if hidden]
    return f"'{_TABLE}' has generated columns" if computed else None
