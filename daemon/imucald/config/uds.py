"""UDS (ISO 14229): the server's ids and who may start routines."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from imucald.config.base import CanId, Positive, Settings

KeyFunctionName = Annotated[str, Meta(pattern=r"^[A-Za-z_][\w.]*:[A-Za-z_]\w*$", max_length=200)]


class SecurityAccess(Settings, frozen=True):
    """Who may start routines."""

    key_function: KeyFunctionName | None = None
    """`module:function` that turns a seed (bytes) into its key (bytes); none: nobody is let in."""
    attempts: Annotated[int, Meta(ge=1, le=10)] = 3
    """Wrong keys before the delay."""
    delay: Positive = 10.0
    """How long no key is taken then [s]."""


class Uds(Settings, frozen=True):
    """An ISO 14229 server over ISO-TP."""

    enabled: bool = False
    """Whether requests are answered; needs the extra `diagnostics`."""
    request_id: CanId = 0x7B0
    """Requests to us."""
    response_id: CanId = 0x7B8
    """Our responses."""
    functional_id: CanId | None = 0x7DF
    """Requests to all nodes; null: these are not listened to."""
    security: SecurityAccess = SecurityAccess()

    def __post_init__(self) -> None:
        ids = [self.request_id, self.response_id, self.functional_id]
        if len(set(ids)) != len(ids):
            raise ValueError("request, response and functional id must differ")
        if (self.request_id > 0x7FF) != (self.response_id > 0x7FF):
            raise ValueError("request and response id must both have 11 bits, or both 29")
