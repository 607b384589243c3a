"""Parts of a service that depend on its configuration. The parts are created at the start and at
each reload.

A reload replaces all parts or none: after a failure, the running parts stay unchanged. This module
also contains the functions that continue parts after a reload.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from msgspec import Struct

from imucald.can.link.link import Link, LinkEvent
from imucald.config import LoadedConfig
from imucald.mount.estimate import MountEstimator
from imucald.mount.estimator import JointEstimator
from imucald.mount.mount_in_force import mount_in_force, without_stored
from imucald.mount.restored import RestoredEstimator
from imucald.runtime.engine import Engine
from imucald.runtime.input_health import LinkHealth
from imucald.runtime.pipeline import Snapshot
from imucald.runtime.session import make_engine, open_config
from imucald.service.background_writer import Say
from imucald.service.calibration_store import SAVE_PERIOD_S, CalibrationStore
from imucald.service.live import open_link
from imucald.service.saved_state import StateStore, state_key

if TYPE_CHECKING:
    from imucald.runtime.consumers import AttitudeConsumer
    from imucald.service.uds_host import RunningService
    from imucald.service.uds_on_bus import BusUds
    from imucald.service.uds_records import AttemptStore, DtcStore


@dataclass(frozen=True)
class ServiceOptions:
    """Options of a service from the command line.

    state_folder, status_socket: paths; None if not used. socket_needed: if True, the service does
    not start without the socket. save_period: period between saves [s]. start_count: path of the
    unit's count of starts (see `notify`).
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


class UdsDiagnostics(Struct, frozen=True):
    """The diagnostics (UDS) of a service.

    uds: server for testers on the bus; None if switched off. dtc_store, keys: trouble codes and
    wrong keys, saved on the disk. Both stores remain while diagnostics are switched off.
    """

    uds: BusUds | None = None
    dtc_store: DtcStore | None = None
    keys: AttemptStore | None = None

    def update(self) -> None:
        """Save changed trouble codes if a save is due."""
        if self.dtc_store is not None:
            self.dtc_store.update()

    def close(self) -> None:
        """Save the trouble codes and wrong keys."""
        if self.dtc_store is not None:
            self.dtc_store.close()
        if self.keys is not None:
            self.keys.close()

    def status(self) -> dict[str, Any] | None:
        """Return the part of `imucald status` about diagnostics; None if diagnostics are switched
        off."""
        if self.uds is None or self.dtc_store is None:
            return None
        return self.uds.status() | {"dtc_memory": self.dtc_store.status()}


@dataclass(frozen=True)
class Parts:
    """The parts of a running service. calibration_store: None if no state is saved."""

    loaded: LoadedConfig
    engine: Engine
    calibration_store: CalibrationStore | None
    diagnostics: UdsDiagnostics
    link: Link


@dataclass(frozen=True)
class Listeners:
    """Callbacks from the parts to their service."""

    on_snapshot: Callable[[Snapshot], None]
    on_link_event: Callable[[LinkEvent], None]
    link_health: Callable[[], LinkHealth]
    say: Say


class PartsMaker:
    """Creates the parts of a service. clock: monotonic [s]."""

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
        """Read the configuration and build its engine.

        The call may take long. The call opens neither the bus nor the saved state.

        Raises ConfigError.
        """
        loaded = open_config(self._options.config, self._options.databases)
        listeners = self._listeners
        return loaded, make_engine(loaded, listeners.on_snapshot, listeners.link_health)

    def first(self, loaded: LoadedConfig, engine: Engine) -> Parts:
        """Return the parts at the start, with the saved state restored.

        Raises ConfigError, LinkError.
        """
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
        """Return the parts for a new configuration. Running parts are used again where possible.
        Raises any exception of a part that cannot be created.
        """
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
        """Return the running estimator if the new configuration allows it. If not, return a new
        estimator that starts with the present mount. The second result is the store that saves the
        estimator.
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
                return restored, store  # another sensor or vehicle: the found mount is not its own
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
        """Return the diagnostics of a configuration, with the data of `before`. Raises
        ConfigError with the place of a mistake."""
        dtc_store, keys = before.dtc_store, before.keys
        if not loaded.config.diagnostics.enabled:
            return UdsDiagnostics(None, dtc_store, keys)
        # This is imported only on use: it loads OpenSSL (3.6 MiB) for keys.
        from imucald.service.uds_on_bus import bus_uds_for  # noqa: PLC0415
        from imucald.service.uds_records import AttemptStore, DtcStore  # noqa: PLC0415

        if dtc_store is None:
            folder, say = self._options.state_folder, self._listeners.say
            key = state_key(loaded, engine.router)
            path = None if folder is None else folder / f"{key.file_name}.troubles"
            dtc_store = DtcStore(path, say, self._clock)
            keys = AttemptStore(folder and folder / "security.keys", say)
        uds = bus_uds_for(self._service, loaded, engine, self._clock, dtc_store.memory, keys)
        return UdsDiagnostics(uds, dtc_store, keys)

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


def listens_otherwise(
    old: LoadedConfig, new: LoadedConfig, old_engine: Engine, new_engine: Engine
) -> bool:
    """Return whether the new configuration has another bus, other inputs or other outputs."""
    return (
        old.config.bus != new.config.bus
        or old.config.diagnostics != new.config.diagnostics
        or set(old_engine.router.matches) != set(new_engine.router.matches)
        or old_engine.output.can_ids != new_engine.output.can_ids
    )


def is_same_bus(old: LoadedConfig, new: LoadedConfig, options: ServiceOptions) -> bool:
    """Return whether both configurations use the same bus. Another bus has another sensor."""

    def names(loaded: LoadedConfig) -> tuple[str, str]:
        bus = loaded.config.bus
        return options.interface or bus.interface, options.channel or bus.channel

    return names(old) == names(new)


def keeps_estimator(
    old: LoadedConfig, new: LoadedConfig, old_engine: Engine, new_engine: Engine
) -> bool:
    """Return whether the running estimator has the settings that the new configuration requires.

    The result is False if a new database changes the meaning of a signal. The known health of the
    sensor belongs to the old signal, so the new signal must first be observed. Changed limits of
    plausible values do not make the result False, because they do not change values: everything
    learnt stays valid, including present faults.
    """
    a, b = old.config, new.config
    before, now = old_engine.router, new_engine.router
    is_same = (a.calibration, a.vehicle) == (b.calibration, b.vehicle)
    return is_same and now.same_sources(before) == before.channels | now.channels


def keeps_consumers(
    old: LoadedConfig, new: LoadedConfig, old_engine: Engine, new_engine: Engine
) -> bool:
    """Return whether the consumers of the calibrated samples (such as the attitude) have the
    settings that the new configuration requires.
    """
    a, b = (
        (c.attitude, c.travel_direction, c.signals, c.output.ids, c.output.checksum)
        for c in (old.config, new.config)
    )
    return a == b and old_engine.model_key == new_engine.model_key


def take_usual_signals(old: Engine, estimator: MountEstimator, new: Engine) -> None:
    """Pass to a new estimator how long each unchanged signal usually keeps a value.

    A signal that has been stuck since before the reload would never show its usual duration.
    """
    former, made = without_stored(old.pipeline.estimator), without_stored(estimator)
    if (
        made is not former
        and isinstance(former, JointEstimator)
        and isinstance(made, JointEstimator)
    ):
        made.take_usual_signals(former, new.router.same_sources(old.router))


def behind_the_known(old: MountEstimator, new: MountEstimator) -> MountEstimator:
    """Return the new estimator, started with the mount of the old estimator. If an order holds the
    mount, the hold continues. If the configuration held the mount, the new configuration decides
    about the hold.
    """
    stored = mount_in_force(old)
    if stored is None:
        return new
    in_front = old if isinstance(old, RestoredEstimator) else None
    by_order = in_front is not None and in_front.is_held and not in_front.by_configuration
    configured = isinstance(new, RestoredEstimator) and new.is_held
    is_held = by_order or configured
    return RestoredEstimator(without_stored(new), stored, is_held, by_configuration=configured)


def attitude_of(engine: Engine) -> AttitudeConsumer | None:
    """Return the attitude of an engine, which checks the sensors at rest; None if it is not
    enabled."""
    found = next((one for one in engine.consumers if one.name == "attitude"), None)
    return cast("AttitudeConsumer | None", found)


def saved_check(engine: Engine) -> Mapping[str, Any] | None:
    """Return the result of the sensor check for the saved state (sensor axes, SI); None before the
    check.
    """
    attitude = attitude_of(engine)
    return None if attitude is None else attitude.saved_check()


def restore_check(engine: Engine, saved: object) -> None:
    """Give the result of a sensor check of an earlier drive to the attitude. saved: content of the
    saved state; an implausible result is ignored."""
    if (attitude := attitude_of(engine)) is not None:
        attitude.restore_check(saved)
