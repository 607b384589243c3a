"""Check without a bus whether `imucald run` could start."""

from __future__ import annotations

from imucald.config import LoadedConfig
from imucald.runtime.session import make_engine
from imucald.service.uds_on_bus import check_diagnostics


def check_start(loaded: LoadedConfig) -> None:
    """Raise ConfigError if `run` would end with this error for the configuration."""
    engine = make_engine(loaded)
    if loaded.config.diagnostics.enabled:
        check_diagnostics(loaded, engine)
