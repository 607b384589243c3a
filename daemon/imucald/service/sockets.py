"""The status socket and the control socket, served by the main loop."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from imucald.core.errors import LinkError
from imucald.runtime.mount_orders import MountOrders
from imucald.service.asking import control_socket
from imucald.service.control import ControlServer
from imucald.service.journal import WARNING, Journal
from imucald.service.status import StatusServer


class Sockets:
    """The status socket and the control socket. The daemon also works without them.

    path: path of the status socket; with None, there is no socket. is_needed: raise LinkError if
    the status socket cannot be created. status: function that returns the status. history: see
    `StatusServer`.
    """

    def __init__(
        self,
        path: Path | None,
        is_needed: bool,
        status: Callable[[], Mapping[str, Any]],
        orders: MountOrders,
        journal: Journal,
        history: Callable[[float], str],
    ) -> None:
        self.status: StatusServer | None = None
        self.control: ControlServer | None = None
        if path is None:
            return
        try:
            self.status = StatusServer(
                path,
                status,
                events=lambda: [event._asdict() for event in journal.events],
                history=history,
                say=journal.say,
            )
            is_needed = False
            self.control = ControlServer(control_socket(path), orders, journal.say)
        except LinkError as error:
            if is_needed:
                raise
            journal.say(f"{error}; continuing without it", WARNING)

    def poll_status(self) -> None:
        """Serve the clients of the status socket. The method is also called during a long batch of
        frames."""
        if self.status is not None:
            self.status.poll()

    def poll(self) -> None:
        """Serve the waiting clients of both sockets."""
        self.poll_status()
        if self.control is not None:
            self.control.poll()

    def close(self) -> None:
        """Remove both sockets."""
        for server in (self.status, self.control):
            if server is not None:
                server.close()
