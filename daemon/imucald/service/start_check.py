"""Check whether `imucald run` can start, without a bus."""

from __future__ import annotations

from imucald.config import LoadedConfig
from imucald.runtime.session import make_engine
from imucald.service.uds_on_bus import check_diagnostics


def check_start(loaded: LoadedConfig) -> None:
    """Raise the ConfigError with which `run` would end, if there is one."""
    engine = make_engine(loaded)
    if loaded.config.diagnostics.enabled:
        check_diagnostics(loaded, engine)
