"""Convert YAML text to plain data with line numbers. The text is parsed, or the result is read from
the cache.
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
"""Largest accepted file [bytes]: a thousand times the size of a real configuration."""


class Parsed(Struct):
    """The data of a YAML text and the lines of its keys, as stored in the cache."""

    data: Any
    marks: list[tuple[Place, int]]


def read_yaml(text: str, name: str) -> tuple[Any, Marks]:
    """Parse YAML to plain data and the line of every key.

    Aliases, repeated keys and deep nesting are refused: no configuration needs them, and a small
    file could otherwise expand without limit. Raises ConfigError with the line. The result is
    cached, because importing the YAML parser takes a tenth of the time of a restart.
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
    """Parse a YAML file. whole: name for the kind of file, such as "configuration".

    Raises ConfigError if the YAML is wrong, or if the file is too long, is not text or cannot be
    read.
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
