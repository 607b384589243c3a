"""Where a daemon's control socket is."""

from __future__ import annotations

from pathlib import Path


def control_socket(status_socket: Path) -> Path:
    """Next to the status socket."""
    if status_socket.name == "status.sock":
        return status_socket.with_name("control.sock")
    return status_socket.with_name(f"{status_socket.name}.control")
