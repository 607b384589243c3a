"""Numbers and lists of any library as the plain data that a YAML file has."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def plain(data: Any) -> Any:
    """Return data with mappings as dict, tuples and arrays as list, numpy's numbers as Python's."""
    if isinstance(data, Mapping):
        return {key: plain(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [plain(value) for value in data]
    return data.tolist() if hasattr(data, "tolist") else data
