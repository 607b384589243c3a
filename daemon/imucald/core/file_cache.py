"""Cache of parsed databases and configurations, because parsing takes milliseconds to seconds.

A cache file contains the original text and the parsed content as JSON. The content is used only if
the text is identical to the text of the file that is read. Reading JSON cannot run code. A damaged
file, or a file from another version, is ignored. No function of this module raises an error.
Without a writable folder that only this user can change, databases are parsed each time.
"""

from __future__ import annotations

import importlib.util
import os
import re
import time
import zlib
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final, TypeVar

import msgspec

MAX_TEXT: Final = 32 * 2**20
"""Largest size of a cached database [characters]."""
MAX_FILES: Final = 64
"""Largest number of databases in the cache. There is one cache file for each path of a database."""
_SUFFIX: Final = ".json"
_UNFINISHED: Final = re.compile(r"[0-9a-f]{8}\.[0-9]+")
"""Name of a file that is being written: its final name, and the process number."""
_CHECK_BYTES: Final = 9
"""Size of the checksum at the start of a file [bytes]: CRC-32 as text, and a newline. The rest of
the file is JSON: stamp, source, text, messages."""

Message = TypeVar("Message")


class _Cache:
    """The folder of the cache. Until a command sets the folder, there is no cache."""

    folder: Path | None = None


def keep_databases(environment: Mapping[str, str]) -> None:
    """Let this process use the cache. The folder is the cache directory that systemd states, else
    the cache directory of the user.

    Only commands call this function; tests and libraries do not use the cache.
    """
    given = environment.get("CACHE_DIRECTORY", "").partition(":")[0]
    home = environment.get("HOME", "")
    user = environment.get("XDG_CACHE_HOME") or (f"{home}/.cache" if home else "")
    text = given or (f"{user}/imucald/databases" if user else "")
    _Cache.folder = Path(text) if text.startswith("/") else None


def find(text: str, source: str, kind: type[Message]) -> list[Message] | None:
    """Return the cached messages of a text from a source; None if they are not in the cache. kind:
    the type of the messages."""
    if _Cache.folder is None or not _is_ours(_Cache.folder):
        return None
    try:
        raw = _place(_Cache.folder, source).read_bytes()
        if raw[:_CHECK_BYTES] != _check(raw[_CHECK_BYTES:]):
            return None
        *about, messages = _decoded(raw[_CHECK_BYTES:], kind)
    except (OSError, ValueError, RecursionError):
        return None
    return messages if about == [_stamp(), source, text] else None


def keep(text: str, source: str, messages: list[Message], kind: type[Message]) -> None:
    """Store the messages of a parsed text in the cache, if possible."""
    if _Cache.folder is None or len(text) > MAX_TEXT:
        return
    try:
        _Cache.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not _is_ours(_Cache.folder):
            return
        content = msgspec.json.encode((_stamp(), source, text, messages))
        if _decoded(content, kind)[-1] != messages:
            return  # numbers that JSON cannot hold
        _drop_unfinished(_Cache.folder)
        _write(_place(_Cache.folder, source), _check(content) + content)
        _drop_oldest(_Cache.folder)
    except (OSError, ValueError, OverflowError, TypeError, RecursionError):
        return


def _decoded(content: bytes, kind: type[Message]) -> tuple[str, str, str, list[Message]]:
    layout = tuple[str, str, str, list[kind]]  # type: ignore[valid-type]
    found: tuple[str, str, str, list[Message]] = msgspec.json.decode(content, type=layout)
    return found


def _write(place: Path, data: bytes) -> None:
    """Write a file completely or not at all: on a full disk, no incomplete file remains. Raises
    OSError."""
    making = place.with_name(f"{place.stem}.{os.getpid()}")
    try:
        making.write_bytes(data)
        making.replace(place)
    except BaseException:
        with suppress(OSError):
            making.unlink()
        raise


def _drop_unfinished(folder: Path) -> None:
    now = time.time()
    for path in folder.iterdir():
        if _UNFINISHED.fullmatch(path.name):
            with suppress(OSError):
                # writing takes less than a second, and the clock may have been set back
                if abs(now - path.stat().st_mtime) > 600.0:
                    path.unlink()


def _drop_oldest(folder: Path) -> None:
    files = sorted(folder.glob(f"*{_SUFFIX}"), key=lambda path: path.stat().st_mtime)
    for path in files[: max(0, len(files) - MAX_FILES)]:
        path.unlink()


def _place(folder: Path, source: str) -> Path:
    return folder / f"{zlib.crc32(source.encode('utf-8', 'surrogateescape')):08x}{_SUFFIX}"


def _check(content: bytes) -> bytes:
    return b"%08x\n" % zlib.crc32(content)


def _is_ours(folder: Path) -> bool:
    try:
        found = folder.stat()
    except OSError:
        return False
    if not hasattr(os, "geteuid"):  # Windows: a user's own folder is closed to others
        return True
    return found.st_uid == os.geteuid() and not found.st_mode & 0o022


def _stamp() -> str:
    """Return a text that identifies the version of the code that reads databases and YAML. The text
    contains size and time of our modules and of their libraries.
    """
    package = Path(__file__).parents[1]
    ours = ("can/dbc/message.py", "can/dbc/parser.py", "core/yaml_parser.py")
    found = [os.stat(f) for f in (*(f"{package}/{name}" for name in ours), *_libraries())]  # noqa: PTH116
    return " ".join(f"{one.st_size} {one.st_mtime_ns}" for one in found)


def _libraries() -> list[str]:
    specs = map(importlib.util.find_spec, ("cantools", "yaml"))
    return [spec.origin for spec in specs if spec is not None and spec.origin]
