"""Sections of the model file, and their values as plain data. Sections are immutable, and unknown
keys are errors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from msgspec import Meta, Struct

Vector3 = tuple[float, float, float]
Fraction = Annotated[float, Meta(ge=0.0, le=1.0)]
NonNegative = Annotated[float, Meta(ge=0.0)]
Positive = Annotated[float, Meta(gt=0.0)]

ZERO: Vector3 = (0.0, 0.0, 0.0)


class Section(Struct, frozen=True, forbid_unknown_fields=True):
    """Base class of all sections. A misspelt key is an error."""


def plain(data: Any) -> Any:
    """Return data with mappings converted to dict, tuples and arrays to list, and numpy numbers to
    Python numbers."""
    if isinstance(data, Mapping):
        return {key: plain(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [plain(value) for value in data]
    return data.tolist() if hasattr(data, "tolist") else data
