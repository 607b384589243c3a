"""The parts of a service that come from its configuration, made once and again at each reload.

A reload exchanges all of them or none: what fails on the way leaves the running ones as they were.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from imucald.can.link.link import Link, LinkEvent
from imucald.config import LoadedConfig
from imucald.mount.estimate import MountEstimator
from imucald.runtime.engine import Engine
from imucald.runtime.input_health import LinkHealth
from imucald.runtime.pipeline import Snapshot
from imucald.runtime.session import make_engine, open_config
from imucald.service.background_writer import Say
from imucald.service.calibration_store import CalibrationStore
from imucald.service.identity import state_key
from imucald.service.live import open_link
from imucald.service.reload_changes import (
    behind_the_known,
    is_same_bus,
    keeps_consumers,
    keeps_estimator,
    listens_otherwise,
    take_usual_signals,
)
from imucald.service.sensor_check import restore_check, saved_check
from imucald.service.service_options import ServiceOptions
from imucald.service.state_file import StateStore
from imucald.service.uds_diagnostics import UdsDiagnostics, diagnostics_for

if TYPE_CHECKING:
    from imucald.service.uds_host import RunningService


@dataclass(frozen=True)
class Parts:
    """What a service runs. calibration_store: None where no state is kept."""

    loaded: LoadedConfig
    engine: Engine
    calibration_store: CalibrationStore | None
    diagnostics: UdsDiagnostics
    link: Link


@dataclass(frozen=True)
class Listeners:
    """What a service hears from its parts, and what they ask it."""

    on_snapshot: Callable[[Snapshot], None]
    on_link_event: Callable[[LinkEvent], None]
    link_health: Callable[[], LinkHealth]
    say: Say


class PartsMaker:
    """Makes the parts of a service. clock: monotonic [s]."""

    def __init__(
        self,
        service: RunningService,
        options: ServiceOptions,
        listeners: Listeners,
        clock: Callable[[], float],
    ) -> None:
        self._service, self._options = service, options
        self._listeners, self._clock = listeners, clock

    def read(self) -> tuple[LoadedConfig, Engine]:
        """Read the configuration and build its engine, which may take long; nothing is opened.

        Raises ConfigError.
        """
        loaded = open_config(self._options.config, self._options.databases)
        listeners = self._listeners
        return loaded, make_engine(loaded, listeners.on_snapshot, listeners.link_health)

    def first(self, loaded: LoadedConfig, engine: Engine) -> Parts:
        """The parts at the start, the saved state restored. Raises ConfigError, LinkError."""
        store = self._new_calibration_store(loaded, engine)
        if store is not None:
            restored = store.restore(engine.pipeline.estimator)
            engine.pipeline.replace(restored, afresh=True)
            restore_check(engine, store.saved_check)
        diagnostics = self._new_diagnostics(loaded, engine, UdsDiagnostics())
        return Parts(
            loaded, engine, store, diagnostics, self._new_link(loaded, engine, diagnostics)
        )

    def after(self, parts: Parts, loaded: LoadedConfig, engine: Engine) -> Parts:
        """The parts of another configuration; what can go on goes on. Raises whatever fails."""
        old, link, diagnostics = parts.engine, parts.link, parts.diagnostics
        try:
            is_other = loaded.config.diagnostics != parts.loaded.config.diagnostics
            if diagnostics.uds is None or is_other:
                diagnostics = self._new_diagnostics(loaded, engine, diagnostics)
            else:
                diagnostics.uds.check_identifiers(loaded, engine)
            if listens_otherwise(parts.loaded, loaded, old, engine):
                link = self._new_link(loaded, engine, diagnostics)
            same_bus = is_same_bus(parts.loaded, loaded, self._options)
            estimator, store = self._estimator_after(parts, loaded, engine, same_bus)
            if same_bus:
                take_usual_signals(old, estimator, engine)
            engine.output.prepare()
            keeps = keeps_consumers(parts.loaded, loaded, old, engine)
            engine.go_on_from(old, estimator, keeps, same_bus)
        except BaseException:
            if link is not parts.link:
                link.close()
            raise
        return Parts(loaded, engine, store, diagnostics, link)

    def _estimator_after(
        self, parts: Parts, loaded: LoadedConfig, engine: Engine, same_bus: bool
    ) -> tuple[MountEstimator, CalibrationStore | None]:
        """The running estimator where it can stay; else a new one behind what is known.

        With it the store that is to keep it.
        """
        running, store = parts.engine, parts.calibration_store
        old, new = running.pipeline.estimator, engine.pipeline.estimator
        is_other_key = state_key(loaded, engine.router) != state_key(parts.loaded, running.router)
        if is_other_key or engine.model_key != running.model_key:
            if store is not None:
                store.save_now(old, running.timebase.now)
            store = self._new_calibration_store(loaded, engine)
            restored = new if store is None else store.restore(new)
            if store is not None:
                restore_check(engine, store.saved_check)
            if is_other_key or restored is not new:
                return restored, store  # another sensor or vehicle: what was found is not of it
            return behind_the_known(old, new), store
        restore_check(engine, saved_check(running))
        if same_bus and keeps_estimator(parts.loaded, loaded, running, engine):
            return old, store
        return behind_the_known(old, new), store

    def _new_calibration_store(
        self, loaded: LoadedConfig, engine: Engine
    ) -> CalibrationStore | None:
        folder = self._options.state_folder
        if folder is None:
            return None
        store = StateStore(folder, state_key(loaded, engine.router, engine.model_key))
        kept = CalibrationStore(store, self._listeners.say, self._options.save_period, self._clock)
        kept.sensor_check = lambda: saved_check(self._service.engine)
        return kept

    def _new_diagnostics(
        self, loaded: LoadedConfig, engine: Engine, before: UdsDiagnostics
    ) -> UdsDiagnostics:
        folder, say = self._options.state_folder, self._listeners.say
        return diagnostics_for(self._service, loaded, engine, before, folder, say, self._clock)

    def _new_link(self, loaded: LoadedConfig, engine: Engine, diagnostics: UdsDiagnostics) -> Link:
        matches, own_ids, uds = engine.router.matches, engine.output.can_ids, diagnostics.uds
        if uds is not None:
            matches, own_ids = matches + uds.matches, own_ids | uds.own_ids
        options = self._options
        return open_link(
            loaded,
            matches,
            own_ids,
            options.interface,
            options.channel,
            self._listeners.on_link_event,
        )
