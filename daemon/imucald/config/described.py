"""What is said of each key, from the models' attribute docstrings into their JSON schema.

pydantic can do this while the models are made, which costs every start of a daemon some 20 ms for
texts that only `imucald schema` shows.
"""

from __future__ import annotations

import ast
import inspect
import itertools
import textwrap
from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel


def described_schema(model: type[BaseModel]) -> dict[str, Any]:
    """JSON schema of a model and of all models within it, with a description of each key."""
    schema = model.model_json_schema()
    models = {found.__name__: found for found in _models_within(model)}
    for name, part in {model.__name__: schema, **schema.get("$defs", {})}.items():
        for key, text in _texts(models[name]).items() if name in models else ():
            if key in part.get("properties", {}):
                part["properties"][key].setdefault("description", text)
    return schema


def _models_within(model: type[BaseModel]) -> Iterator[type[BaseModel]]:
    """All models of this family: those that stand in modules of its package."""
    (base,) = model.__bases__
    pending: list[type[BaseModel]] = list(base.__subclasses__())
    while pending:
        found = pending.pop()
        pending.extend(found.__subclasses__())
        yield found


def _texts(model: type[BaseModel]) -> dict[str, str]:
    """The string that follows each annotated name in the class's source."""
    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(model))).body
    found: dict[str, str] = {}
    for field, text in itertools.pairwise(tree.body if isinstance(tree, ast.ClassDef) else []):
        match field, text:
            case (
                ast.AnnAssign(target=ast.Name(id=name)),
                ast.Expr(value=ast.Constant(value=str(said))),
            ):
                found[name] = inspect.cleandoc(said)
    return found
