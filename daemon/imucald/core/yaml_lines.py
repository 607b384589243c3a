"""YAML to plain data that knows its lines: parsed, or as the same text was parsed before."""

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
    """What a text says, and the lines of its keys, as it is kept between runs."""

    data: Any
    marks: list[tuple[Place, int]]


def read_yaml(text: str, name: str) -> tuple[Any, Marks]:
    """Parse YAML to plain data and the line of every key.

    Aliases, repeated keys and deep nesting are refused: no configuration needs them, and they are
    how a file becomes a bomb. Raises ConfigError with the line. What was parsed is kept where
    databases are: importing a parser of YAML is a tenth of a restart.
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
    """The same of a file; whole: what the file is, as "configuration".

    Raises ConfigError also where the file is too long, is no text or cannot be read.
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
