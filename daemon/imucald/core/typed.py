"""Data of a YAML file -> a typed structure. Every mistake is one line: file, line, key, remedy."""

from __future__ import annotations

from typing import Any, TypeVar

import msgspec

from imucald.core.errors import ConfigError
from imucald.core.explain import explain
from imucald.core.locations import Document, Place, infinite_places

T = TypeVar("T")


def typed(
    data: Any,
    kind: type[T],
    document: Document,
    *,
    full: Any = None,
    at: Place = (),
) -> T:
    """Return data as a value of a kind (a msgspec structure, or any type of a field).

    full: the data with all short forms spelled out, where they have any. at: the key that the
    data stand at.
    Raises ConfigError with one line for each mistake.
    """
    infinite = [
        f"{document.located((*at, *place))}: must be a finite number"
        for place in infinite_places(data)
    ]
    if infinite:
        raise ConfigError("\n".join(infinite))
    full = data if full is None else full
    try:
        return msgspec.convert(full, kind)
    except (ValueError, OverflowError) as error:  # msgspec.ValidationError is a ValueError
        lines = list(explain(data, full, kind, document, at))
        lines = lines or [f"{document.located(at)}: {error}"]
        raise ConfigError("\n".join(lines)) from None
