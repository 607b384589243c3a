"""Diagnostics (UDS) of a service: what answers on the bus, and what of it outlives the process."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msgspec import Struct

from imucald.config import LoadedConfig
from imucald.runtime.engine import Engine
from imucald.service.background_writer import Say
from imucald.service.identity import state_key

if TYPE_CHECKING:
    from imucald.service.attempt_store import AttemptStore
    from imucald.service.dtc_store import DtcStore
    from imucald.service.uds_host import RunningService
    from imucald.service.uds_on_bus import BusUds


class UdsDiagnostics(Struct, frozen=True):
    """uds: serves testers; None: switched off.

    dtc_store, keys: trouble codes and wrong keys, kept on the disk; once made they stay, also while
    diagnostics are switched off.
    """

    uds: BusUds | None = None
    dtc_store: DtcStore | None = None
    keys: AttemptStore | None = None

    def update(self) -> None:
        """Save trouble codes where it is due."""
        if self.dtc_store is not None:
            self.dtc_store.update()

    def close(self) -> None:
        """Save what is kept."""
        if self.dtc_store is not None:
            self.dtc_store.close()
        if self.keys is not None:
            self.keys.close()

    def status(self) -> dict[str, Any] | None:
        """What `imucald status` shows of it; None: switched off."""
        if self.uds is None or self.dtc_store is None:
            return None
        return self.uds.status() | {"dtc_memory": self.dtc_store.status()}


def diagnostics_for(
    service: RunningService,
    loaded: LoadedConfig,
    engine: Engine,
    before: UdsDiagnostics,
    folder: Path | None,
    say: Say,
    clock: Callable[[], float],
) -> UdsDiagnostics:
    """The diagnostics of a configuration, going on from those before.

    folder: of the saved state. Raises ConfigError with the place of a mistake.
    """
    dtc_store, keys = before.dtc_store, before.keys
    if not loaded.config.diagnostics.enabled:
        return UdsDiagnostics(None, dtc_store, keys)
    # imported only where it is wanted: it loads OpenSSL (3.6 MiB) for keys
    from imucald.service.attempt_store import AttemptStore  # noqa: PLC0415
    from imucald.service.dtc_store import DtcStore  # noqa: PLC0415
    from imucald.service.uds_on_bus import bus_uds_for  # noqa: PLC0415

    if dtc_store is None:
        key = state_key(loaded, engine.router)
        path = None if folder is None else folder / f"{key.file_name}.troubles"
        dtc_store = DtcStore(path, say, clock)
        keys = AttemptStore(folder and folder / "security.keys", say)
    uds = bus_uds_for(service, loaded, engine, clock, dtc_store.memory, keys)
    return UdsDiagnostics(uds, dtc_store, keys)
