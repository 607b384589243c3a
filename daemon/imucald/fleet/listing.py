"""List the logs of a fleet. Changed logs are detected by address and fingerprint, without reading
their content."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from typing import Any

import msgspec

from imucald.core.errors import ImucaldError
from imucald.fleet.fetch import LOCAL, bare_path, file_system, protocol_of
from imucald.fleet.fleet_file import Fleet, patterns


class Log(msgspec.Struct, frozen=True):
    """One log of a listing. fingerprint: changes with the content. changed: UNIX time of the last
    change [s].

    within: folder that must contain the log after links are followed; None if the log was named
    without a wildcard.
    """

    source: str
    bytes: int
    fingerprint: str
    changed: float | None = None
    within: str | None = None


def list_logs(fleet: Fleet) -> list[Log]:
    """Return all logs of a fleet, each address once, sorted. Raises ImucaldError if there is no
    log."""
    found = {log.source: log for pattern in patterns(fleet.settings) for log in _of(fleet, pattern)}
    if not found:
        text = ", ".join(patterns(fleet.settings))
        raise ImucaldError(f"there is no log at {text}")
    return [found[source] for source in sorted(found)]


def _of(fleet: Fleet, pattern: str, lists: tuple[str, ...] = ()) -> Iterator[Log]:
    """Yield the logs of a pattern. lists: the list files that led to this pattern; a list that
    contains itself is refused.
    """
    storage = fleet.settings.storage
    url = pattern
    if protocol_of(pattern) == "memory":
        raise ImucaldError(
            f"{pattern}: logs cannot be read from memory, since other processes "
            "read them; give files"
        )
    if protocol_of(pattern) in LOCAL:
        url = str(fleet.folder / bare_path(pattern))
    if url.lower().endswith((".csv", ".txt")) and not any(c in url for c in "*?["):
        if url in lists:
            raise ImucaldError(f"{url}: this list contains itself")
        for address in _listed(url, storage):
            yield from _of(fleet, address, (*lists, url))
        return
    system = file_system(url, storage)
    try:
        entries = system.glob(url, detail=True)
    except Exception as error:  # each storage has its own errors
        raise ImucaldError(
            f"{pattern}: cannot be listed: {type(error).__name__}: {error}"
        ) from None
    for name, entry in entries.items():
        if entry.get("type") != "directory":
            yield _log(str(name), entry, protocol_of(url), _root(url))


def _listed(url: str, storage: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return the addresses in a list: one per line, or the column `log` (else the first column) of
    a CSV file."""
    try:
        text = file_system(url, storage).cat_file(url).decode("utf-8-sig")
        rows = [row for row in csv.reader(io.StringIO(text)) if row and not row[0].startswith("#")]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ImucaldError(f"{url}: cannot be read: {error}") from None
    if url.lower().endswith(".csv") and rows and "log" in rows[0]:
        column = rows[0].index("log")
        return [row[column] for row in rows[1:] if len(row) > column]
    return [row[0].strip() for row in rows]


def _root(url: str) -> str | None:
    """Return the folder of the files of a local pattern: its path up to the first wildcard. None if
    there is no wildcard."""
    fixed = re.split(r"[*?\[]", url, maxsplit=1)[0]
    if fixed == url or protocol_of(url) not in LOCAL:
        return None
    return fixed.rpartition("/")[0] or "/"


def _log(name: str, entry: Mapping[str, Any], protocol: str, within: str | None = None) -> Log:
    changed = _unix(entry.get("mtime") or entry.get("LastModified") or entry.get("last_modified"))
    size = int(entry.get("size") or 0)
    tag = entry.get("ETag") or entry.get("etag") or entry.get("md5Hash") or entry.get("CRC")
    fingerprint = f"{size}-{tag}" if tag else f"{size}-{0.0 if changed is None else changed:.6f}"
    source = name if protocol in LOCAL else f"{protocol}://{name.removeprefix(f'{protocol}://')}"
    return Log(source, size, fingerprint.replace('"', ""), changed, within)


def _unix(value: object) -> float | None:
    if isinstance(value, datetime):
        return (value if value.tzinfo else value.replace(tzinfo=UTC)).timestamp()
    return float(value) if isinstance(value, int | float) else None


def is_since(log: Log, day: str | None, since: str) -> bool:
    """True if a log is from the day `since` (ISO) or later. day: day in the log's address; without
    it, the day of the last change is used."""
    if day is None and log.changed is not None:
        day = datetime.fromtimestamp(log.changed, UTC).date().isoformat()
    return day is None or day >= since
