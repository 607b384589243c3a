"""What all parts of the configuration are made of."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

STANDARD_ID_MAX = 0x7FF
EXTENDED_ID_MAX = 0x1FFF_FFFF


class Model(BaseModel):
    """Unknown keys, NaN and infinity are mistakes; nothing changes once it is read."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        allow_inf_nan=False,
        defer_build=True,  # validators are built when first used: the start is quicker
    )


CanId = Annotated[int, Field(ge=0, le=EXTENDED_ID_MAX)]
Positive = Annotated[float, Field(gt=0)]
Share = Annotated[float, Field(gt=0, le=1)]


def as_list(value: Any) -> Any:
    """One entry may stand where a list is expected."""
    return value if isinstance(value, list | tuple) or value is None else [value]
