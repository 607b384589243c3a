"""The control socket: orders from root to a running daemon, one JSON line each.

The orders are ``{"order": "reset"}``, ``hold``, ``release`` and ``set-mount``. The order
``set-mount`` has a key ``mount`` with the same content as `calibration: mount` in the
configuration. The answer is one JSON line: ``{"done": TEXT}`` or ``{"error": TEXT}``. Only root and
the daemon's own user may give orders.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal

from msgspec import DecodeError, Meta, Struct
from msgspec.json import Decoder

from imucald.config.calibration import KnownMount
from imucald.core.errors import ImucaldError
from imucald.core.text import json_text
from imucald.runtime.mount_orders import MountOrders
from imucald.service.background_writer import Say
from imucald.service.journal import WARNING
from imucald.service.line_server import ROOT, LineServer, Peer

BURST = 5
"""Largest number of requests that are accepted without a pause; afterwards one per `PERIOD_S`."""
PERIOD_S = 1.0
"""Shortest time between requests after a burst [s]. A person does not type faster, and each request
creates a new estimator.
"""


class Order(Struct, forbid_unknown_fields=True):
    """An order (see `MountOrders`). sudo_user: the user who gave the order as root with sudo.
    mount: for `set-mount` only."""

    order: Literal["reset", "hold", "release", "set-mount"]
    sudo_user: Annotated[str, Meta(pattern=r"^[A-Za-z0-9_.-]{1,32}$")] | None = None
    mount: KnownMount | None = None


_DECODER = Decoder(Order)


class ControlServer(LineServer):
    """Receives orders on a Unix socket that only its owner and root may open.

    Raises LinkError when the socket cannot be made.
    """

    def __init__(
        self,
        path: Path,
        orders: MountOrders,
        say: Say,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(path, 0o600, self._answer, clock, say=say)
        self._orders = orders
        self._say = say
        self._left, self._at = float(BURST), clock()

    def _answer(self, line: bytes, peer: Peer) -> bytes:
        if peer.uid not in self._owners:
            return self._refused(
                f"user {peer.uid} may not give orders; run the command as root (sudo)", peer
            )
        if not self._has_token():
            return _line(error=f"too many orders; try again in {PERIOD_S:g} s")
        try:
            order = _DECODER.decode(line)
        except (DecodeError, ValueError, RecursionError) as error:  # not JSON, UTF-8, an order
            return _line(error=f"not understood: {error}")
        try:
            return _line(done=self._carried_out(order, peer))
        except ImucaldError as error:
            return self._refused(str(error), peer)
        except Exception as error:  # whatever it is: frames go on
            return self._refused(f"it failed ({type(error).__name__}: {error})", peer)

    def _has_token(self) -> bool:
        now = self._clock()
        self._left = min(self._left + (now - self._at) / PERIOD_S, float(BURST))
        self._at = now
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True

    def _carried_out(self, order: Order, peer: Peer) -> str:
        who = _name(peer, order.sudo_user)
        if order.order == "set-mount":
            if order.mount is None:
                raise ImucaldError("set-mount needs a mount")
            return self._orders.set_mount(order.mount, who)
        if order.mount is not None:
            raise ImucaldError(f"{order.order} takes no mount")
        orders = self._orders
        carry_out = {"reset": orders.reset, "hold": orders.hold, "release": orders.release}
        return carry_out[order.order](who)

    def _refused(self, text: str, peer: Peer) -> bytes:
        self._say(f"an order of {_name(peer)} was refused: {text}", WARNING)
        return _line(error=text)


def _name(peer: Peer, sudo_user: str | None = None) -> str:
    """Return a name for the person who gave an order. Names of users are not looked up, because a
    look-up may contact a remote server."""
    user = "root" if peer.uid == ROOT else f"user {peer.uid}"
    behind = f", for {sudo_user}" if sudo_user else ""
    return f"{user} (pid {peer.pid}{behind})"


def _line(**content: str) -> bytes:
    return json_text(content).encode() + b"\n"
