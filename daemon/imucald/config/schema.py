"""Make the JSON schemas of imucald's YAML files. The docstring of each key is its description.

The schema is draft 7, because the language servers of editors do not support later drafts. Only
`imucald schema` and commands that write YAML files use this module.
"""

from __future__ import annotations

import ast
import inspect
import itertools
import sys
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Any

import msgspec
from msgspec import Struct

from imucald.config.signals import ONE_OF_LIST, SHORT_TEXTS

REFERENCE = "#/definitions/"
LIMITS = frozenset({"minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum"})
"""Keys of limits. Whole limits are written without a fraction: `Meta(le=5)` and `Meta(le=5.0)` are
equal to `typing`, which keeps the one of the module that is imported first."""


def described_schema(
    kind: type[Struct], choices: Mapping[tuple[str, str], Sequence[str]]
) -> dict[str, Any]:
    """Return the JSON schema of settings and their parts, with a description of each key.

    choices: the allowed values of keys whose values another package defines, by class name and key.
    """
    _, parts = msgspec.json.schema_components([kind], ref_template=f"{REFERENCE}{{name}}")
    kinds = {found.__name__: found for found in _within(kind.__mro__[1])}
    for name, part in parts.items():
        part["properties"] = {k: _with_short(v) for k, v in part.get("properties", {}).items()}
        for key, text in _texts(kinds[name]).items():
            if key in part["properties"]:
                part["properties"][key].setdefault("description", text)
    for (name, key), words in choices.items():
        parts[name]["properties"][key]["enum"] = list(words)
    whole = parts.pop(kind.__name__)
    return {
        "$schema": "http://json-schema.org/draft-07/schema#",
        **_as_draft_7({**whole, "definitions": parts}),
    }


def _with_short(node: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a key, extended by its short forms."""
    found = dict(node)
    if "anyOf" in found:
        branches = [_with_short(branch) for branch in found.pop("anyOf")]
        flat = [part for branch in branches for part in branch.get("anyOf", [branch])]
        return {**found, "anyOf": flat}
    name = found.get("$ref", "").removeprefix(REFERENCE)
    if name in SHORT_TEXTS:
        reference: dict[str, Any] = {"$ref": found.pop("$ref")}
        return {**found, "anyOf": [reference, SHORT_TEXTS[name]]}
    if isinstance(found.get("items"), dict):
        one = found["items"]
        found["items"] = _with_short(one)
        if one.get("$ref", "").removeprefix(REFERENCE) in ONE_OF_LIST:
            single = _with_short(one)
            about: dict[str, Any] = {
                k: found.pop(k) for k in ("default", "description") if k in found
            }
            return {**about, "anyOf": [found, *single.get("anyOf", [single])]}
    return found


def _as_draft_7(node: Any) -> Any:
    """Convert a schema of msgspec from draft 2020-12 to draft 7."""
    if isinstance(node, list):
        return [_as_draft_7(one) for one in node]
    if not isinstance(node, dict):
        return node
    found = {key: _as_draft_7(value) for key, value in node.items()}
    for key in LIMITS & found.keys():
        if isinstance(found[key], float) and found[key].is_integer():
            found[key] = int(found[key])
    if "prefixItems" in found:
        found["additionalItems"] = found.pop("items", True)
        found["items"] = found.pop("prefixItems")
    if "$ref" in found and len(found) > 1:  # draft 7 ignores keys next to a reference
        found["allOf"] = [{"$ref": found.pop("$ref")}]
    return found


def _within(base: type) -> Iterator[type]:
    pending: list[type] = list(base.__subclasses__())
    while pending:
        found = pending.pop()
        pending.extend(found.__subclasses__())
        yield found


@cache
def _classes(module: str) -> dict[str, ast.ClassDef]:
    tree = ast.parse(inspect.getsource(sys.modules[module]))
    return {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}


def _texts(kind: type) -> dict[str, str]:
    """Return the docstring after each annotated name in the source of a class."""
    found: dict[str, str] = {}
    for field, text in itertools.pairwise(_classes(kind.__module__)[kind.__name__].body):
        match field, text:
            case (
                ast.AnnAssign(target=ast.Name(id=name)),
                ast.Expr(value=ast.Constant(value=str(meaning))),
            ):
                found[name] = inspect.cleandoc(meaning)
    return found
