"""Sections of the model file. Sections are immutable, and unknown keys are errors."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

Vector3 = tuple[float, float, float]
Fraction = Annotated[float, Meta(ge=0.0, le=1.0)]
NonNegative = Annotated[float, Meta(ge=0.0)]
Positive = Annotated[float, Meta(gt=0.0)]

ZERO: Vector3 = (0.0, 0.0, 0.0)


class Section(Struct, frozen=True, forbid_unknown_fields=True):
    """Base class of all sections. A misspelt key is an error."""
