"""What all parts of the configuration are made of."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

STANDARD_ID_MAX = 0x7FF
EXTENDED_ID_MAX = 0x1FFF_FFFF


class Model(Struct, frozen=True, forbid_unknown_fields=True):
    """Unknown keys are mistakes; nothing changes once it is read."""


CanId = Annotated[int, Meta(ge=0, le=EXTENDED_ID_MAX)]
Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]
Share = Annotated[float, Meta(ge=0, le=0.5)]
"""Relative uncertainty."""
Angle = Annotated[float, Meta(ge=-180, le=180)]
"""[deg]"""
