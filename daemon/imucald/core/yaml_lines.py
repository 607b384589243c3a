"""Convert YAML to plain data with line numbers: parsed now, or taken from the cache of the same
text.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from msgspec import Struct

from imucald.core import file_cache
from imucald.core.errors import ConfigError
from imucald.core.files import read_regular
from imucald.core.typed import Marks, Place

MAX_FILE_BYTES = 1_000_000
"""Largest accepted file: a thousand times a real one."""


class Parsed(Struct):
    """Content of a text, and the lines of its keys, as cached between runs."""

    data: Any
    marks: list[tuple[Place, int]]


def read_yaml(text: str, name: str) -> tuple[Any, Marks]:
    """Parse YAML to plain data and the line of every key.

    Aliases, repeated keys and deep nesting are refused: no configuration needs them, and they let a
    small file expand without limit. Raises ConfigError with the line. The result is cached with the
    databases, because importing a YAML parser takes a tenth of a restart.
    """
    source = f"yaml {name}"
    kept = file_cache.find(text, source, Parsed)
    if kept:
        return kept[0].data, dict(kept[0].marks)
    from imucald.core.yaml_parser import parse_yaml  # noqa: PLC0415 - a lighter start without

    data, marks = parse_yaml(text, name)
    file_cache.keep(text, source, [Parsed(data, list(marks.items()))], Parsed)
    return data, marks


def read_yaml_file(path: Path, whole: str) -> tuple[Any, Marks]:
    """Parse a file. whole: name of the kind of file, as "configuration".

    Raises ConfigError also if the file is too long, is not text or cannot be read.
    """
    try:
        data = read_regular(path, MAX_FILE_BYTES)
        if len(data) > MAX_FILE_BYTES:
            raise ConfigError(f"{path}: more than {MAX_FILE_BYTES} bytes: too long for a {whole}")
        text = data.decode("utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: is not UTF-8 text: {error.reason}") from None
    return read_yaml(text, str(path))
