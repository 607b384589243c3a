"""Convert numbers and lists of any library to plain data for a YAML file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def plain(data: Any) -> Any:
    """Return data with mappings converted to dict, tuples and arrays to list, and numpy numbers to
    Python numbers."""
    if isinstance(data, Mapping):
        return {key: plain(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [plain(value) for value in data]
    return data.tolist() if hasattr(data, "tolist") else data
