"""What all parts of the configuration are made of."""

from __future__ import annotations

from collections.abc import Callable
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


class ShortForm:
    """Tells the JSON schema of a short form that a validator accepts besides the full one.

    short: full form's schema -> that of the short form.
    """

    def __init__(self, short: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
        self._short = short

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> dict[str, Any]:
        full: dict[str, Any] = handler(core)
        return {"anyOf": [full, self._short(full)]}


OR_TEXT = ShortForm(lambda _: {"type": "string"})
"""A text may stand where a mapping is expected."""


def _one_entry(full: dict[str, Any]) -> dict[str, Any]:
    if "minLength" in full:  # pydantic cannot see that a list comes out of the validator
        full["minItems"] = full.pop("minLength")
    return dict(full["items"])


OR_ONE = ShortForm(_one_entry)
"""One entry may stand where a list of them is expected; see `as_list`."""


def as_list(value: Any) -> Any:
    """One entry may stand where a list is expected."""
    return value if isinstance(value, list | tuple) or value is None else [value]
