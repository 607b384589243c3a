"""What the command line says of a service."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from imucald.service.calibration_store import SAVE_PERIOD_S


@dataclass(frozen=True)
class ServiceOptions:
    """What the command line says.

    state_folder, status_socket: None for none. socket_needed: without it nothing starts.
    save_period: [s]. start_count: the unit's file (see `notify`).
    """

    config: Path
    databases: Sequence[Path] = ()
    interface: str | None = None
    channel: str | None = None
    state_folder: Path | None = None
    status_socket: Path | None = None
    socket_needed: bool = True
    save_period: float = SAVE_PERIOD_S
    start_count: Path | None = None
