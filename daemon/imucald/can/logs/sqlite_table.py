"""Whether the messages of a database log are rows that are there.

A view, a virtual table or a generated column is worked out while it is read: a file of 4 kB can
have rows without end, or one of a gigabyte.
"""

from __future__ import annotations

import contextlib
import sqlite3
from pathlib import Path

_TABLE = "messages"
"""As python-can's SqliteWriter names it."""


def why_not_stored(path: Path) -> str | None:
    """Why a database's messages cannot be read; None where they are a plain table, or where it is
    for the reader to say what is missing."""
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
