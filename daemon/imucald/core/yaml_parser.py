"""Convert YAML text to plain data with the line of every key. The text is untrusted."""

from __future__ import annotations

import re
from typing import Any

import yaml

from imucald.core.errors import ConfigError
from imucald.core.text import encodable
from imucald.core.typed import Marks, Place

MAX_DEPTH = 30
"""Deepest accepted nesting."""
MAX_EVENTS = 20_000
"""Largest number of parser events (keys, values, beginnings and ends of collections): thirty times
the number in a complete model file.
"""

_NESTED = "nested too deeply"
_NUMBER_TAGS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")
_EXPONENT = re.compile(r"[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+")
"""Numbers such as 1e-3, which YAML 1.1 reads as text and YAML 1.2 reads as numbers."""


def parse_yaml(text: str, name: str) -> tuple[Any, Marks]:
    """Parse YAML to plain data and the line of every key.

    Aliases, repeated keys and deep nesting are refused: no configuration needs them, and a small
    file could otherwise expand without limit. Raises ConfigError with the line.
    """
    try:
        loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)(text)
        try:
            _refuse_heavy(text, type(loader), name)
            node = loader.get_single_node()
            marks: Marks = {}
            data = None if node is None else _build(loader, node, (), marks, name)
        finally:
            loader.dispose()
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = mark.line + 1 if mark is not None else 1
        problem = getattr(error, "problem", None) or str(error).splitlines()[0]
        # libyaml may detect it before this module does (since PyYAML 6.0.4)
        if problem == "exceeded maximum nesting depth":
            raise ConfigError(f"{name}:{line}: {_NESTED}") from None
        if _has_tab(text, line):
            problem += "; indent with spaces, not tabs"
        raise ConfigError(f"{name}:{line}: not valid YAML: {problem}") from None
    except (RecursionError, ValueError, OverflowError) as error:
        raise ConfigError(f"{name}:1: not usable YAML: {error}") from None
    return data, marks


def _refuse_heavy(text: str, loader: type, name: str) -> None:
    """Refuse a text that is nested too deeply or has too many events. The events are checked one by
    one before the text is composed, because composing is recursive and the recursion in C has no
    limit.
    """
    depth = 0
    for count, event in enumerate(yaml.parse(text, Loader=loader)):
        line = event.start_mark.line + 1 if event.start_mark else 1
        if isinstance(event, yaml.AliasEvent):
            raise ConfigError(f"{name}:{line}: YAML aliases (*name) are not accepted")
        if isinstance(event, yaml.ScalarEvent) and encodable(event.value) != event.value:
            # libyaml itself refuses such a character; the parser of a PyYAML without libyaml does
            # not.
            raise ConfigError(f"{name}:{line}: a character that UTF-8 cannot encode")
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > MAX_DEPTH:
            raise ConfigError(f"{name}:{line}: {_NESTED}")
        if count > MAX_EVENTS:
            raise ConfigError(f"{name}:{line}: more keys and values than any real file has")


def _has_tab(text: str, line: int) -> bool:
    lines = text.splitlines()
    return line <= len(lines) and "\t" in lines[line - 1]


def _build(loader: Any, node: yaml.Node, place: Place, marks: Marks, name: str) -> Any:
    line = node.start_mark.line + 1
    marks.setdefault(place, line)
    if isinstance(node, yaml.SequenceNode):
        return [_build(loader, n, (*place, i), marks, name) for i, n in enumerate(node.value)]
    if isinstance(node, yaml.MappingNode):
        result: dict[str, Any] = {}
        for key_node, value_node in node.value:
            key_line = key_node.start_mark.line + 1
            if not isinstance(key_node, yaml.ScalarNode):
                raise ConfigError(f"{name}:{key_line}: a key must be a plain word")
            key = key_node.value
            if key in result:
                raise ConfigError(f"{name}:{key_line}: the key '{key}' occurs here a second time")
            marks[(*place, key)] = key_line
            result[key] = _build(loader, value_node, (*place, key), marks, name)
        return result
    # the time for numbers in base 60 (1:30:00) grows with the square of their length
    if node.tag in _NUMBER_TAGS and len(node.value) > 64:
        raise ConfigError(f"{name}:{line}: a number of {len(node.value)} characters")
    value = _scalar(loader, node)
    if value is not None and not isinstance(value, str | int | float | bool):
        raise ConfigError(f"{name}:{line}: {node.value!r} is neither text nor number")
    return value


def _scalar(loader: Any, node: yaml.Node) -> Any:
    value = loader.construct_object(node)
    is_plain = isinstance(node, yaml.ScalarNode) and node.style not in ("'", '"', "|", ">")
    if is_plain and isinstance(value, str) and _EXPONENT.fullmatch(value):
        return float(value)
    return value
