"""What validation found wrong, said to the one who wrote the file."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterator
from typing import Any

from pydantic import ValidationError

from imucald.config.yaml_lines import Marks, Place, dotted, line_of

Schema = Callable[[], dict[str, Any]]
"""Gives the JSON schema; made only when a mistake has to be explained."""


def explain(
    error: ValidationError, schema: Schema, marks: Marks, name: str, data: Any
) -> Iterator[str]:
    """One line for each mistake: file, line, key, reason, remedy."""
    for item in error.errors(include_url=False):
        place = _real_place(item["loc"], data)
        yield f"{name}:{line_of(marks, place)}: {dotted(place)}: {_reason(item, place, schema)}"


def _real_place(loc: Place, data: Any) -> Place:
    """Drop what shorthands added to the path (the index of a single source, union branches)."""
    place: list[str | int] = []
    here = data
    last = len(loc) - 1
    for i, part in enumerate(loc):
        if isinstance(here, dict) and isinstance(part, str) and (part in here or i == last):
            place.append(part)
            here = here.get(part)
        elif isinstance(here, list) and isinstance(part, int) and part < len(here):
            place.append(part)
            here = here[part]
    return tuple(place)


def _reason(item: Any, place: Place, schema: Schema) -> str:
    kind = item["type"]
    if kind == "extra_forbidden":
        allowed = _allowed_keys(place[:-1], schema())
        close = difflib.get_close_matches(str(place[-1]), allowed, n=1)
        hint = f"did you mean '{close[0]}'?" if close else "allowed: " + ", ".join(allowed)
        return f"unknown key; {hint}"
    if kind == "missing":
        return "is missing"
    message = str(item["msg"]).removeprefix("Value error, ")
    value = item.get("input")
    if isinstance(value, str | int | float | bool) or value is None:
        return f"{message[:1].lower()}{message[1:]} (here: {value!r})"
    return f"{message[:1].lower()}{message[1:]}"


def _allowed_keys(place: Place, schema: dict[str, Any]) -> list[str]:
    """Keys allowed at a place, by walking the models' JSON schema."""
    definitions = schema.get("$defs", {})
    here: list[dict[str, Any]] = [schema]
    for part in place:
        here = [branch for node in here for branch in _children(node, part, definitions)]
    return sorted({key for node in here for key in node.get("properties", {})})


def _children(
    node: dict[str, Any], part: str | int, definitions: dict[str, Any]
) -> Iterator[dict[str, Any]]:
    if isinstance(part, int):
        step = node.get("items", {})
    else:
        step = node.get("properties", {}).get(part) or node.get("additionalProperties") or {}
    pending = [step] if isinstance(step, dict) else []
    while pending:
        branch = pending.pop()
        if "$ref" in branch:
            branch = definitions.get(str(branch["$ref"]).rsplit("/", 1)[-1], {})
        pending.extend(branch.get("anyOf", []))
        # a single source may stand where a list of them is described
        if "items" in branch and isinstance(branch["items"], dict):
            pending.append(branch["items"])
        yield branch
