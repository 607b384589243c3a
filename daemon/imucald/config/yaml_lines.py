"""YAML to plain data that knows its lines: parsed, or as the same text was parsed before."""

from __future__ import annotations

from typing import Any

from msgspec import Struct

from imucald.config.locations import Marks, Place, dotted, infinite_places, line_of
from imucald.core import file_cache as database_cache

MAX_FILE_BYTES = 1_000_000
"""Largest accepted file: a thousand times a real one."""
__all__ = [
    "MAX_FILE_BYTES",
    "Marks",
    "Place",
    "dotted",
    "infinite_places",
    "line_of",
    "read_yaml",
]


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
    kept = database_cache.find(text, source, Parsed)
    if kept:
        return kept[0].data, dict(kept[0].marks)
    from imucald.config.yaml_parser import parse_yaml  # noqa: PLC0415 - a lighter start without

    data, marks = parse_yaml(text, name)
    database_cache.keep(text, source, [Parsed(data, list(marks.items()))], Parsed)
    return data, marks
