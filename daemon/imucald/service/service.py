"""The service around the loop: saved state, systemd, status, reload. All of it in the loop's turns.

The loop comes by `CHORE_S` after the last time at the latest (bus traffic or not), so that what
systemd's watchdog hears comes from the loop that corrects frames and from nothing else.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from msgspec.structs import asdict

from imucald.can.link.link import Link, LinkCounters, LinkEvent
from imucald.config import LoadedConfig
from imucald.core.errors import ImucaldError
from imucald.mount.estimate import MountEstimate, MountEstimator
from imucald.mount.mount_words import reasons_line
from imucald.runtime.consumer import ChecksSensors
from imucald.runtime.engine import Engine
from imucald.runtime.input_health import LinkHealth
from imucald.runtime.mount_orders import TESTER, MountOrders
from imucald.runtime.pipeline import Snapshot
from imucald.runtime.session import make_engine, open_config
from imucald.service.alarm_watch import AlarmWatch
from imucald.service.calibration_store import SAVE_PERIOD_S, CalibrationStore
from imucald.service.figures import status_line
from imucald.service.folder_lock import FolderLock
from imucald.service.identity import state_key
from imucald.service.journal import ERROR, INFO, NOTICE, WARNING, Journal
from imucald.service.live import Daemon, open_link
from imucald.service.notify import Notifier
from imucald.service.prepared import Prepared
from imucald.service.reload_changes import behind_the_known, estimates_alike, listens_otherwise
from imucald.service.running_status import InputRates, run_result, running_status
from imucald.service.sockets import Sockets
from imucald.service.start_count import StartCount
from imucald.service.state_file import StateStore, clear_unfinished

if TYPE_CHECKING:
    from imucald.service.attempt_store import AttemptStore
    from imucald.service.dtc_store import DtcStore
    from imucald.service.uds_on_bus import BusUds

CHORE_S = 0.1
"""The loop turns to everything but frames so often [s]."""
SECOND_S = 1.0
"""Rates and the status line are made so often [s]."""
_QUIET_EVENTS = frozenset({"up", "lost", "conflict", "queue_full"})
"""Kinds of link events that are no warnings, or that the link tells seldom by itself."""


@dataclass(frozen=True)
class ServiceOptions:
    """What the command line says.

    state_folder, status_socket: None for none. socket_needed: without it nothing starts.
    save_period: [s]. start_count: the unit's file (see `start_count`).
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


class Companion(Protocol):
    """A process that serves beside this one; it ends with it."""

    def poll(self) -> bool:
        """Whether it has just ended by itself."""
        ...

    def close(self) -> None:
        """Have it end."""
        ...


class Service:
    """Runs the daemon of one configuration. Raises ConfigError, LinkError at the start."""

    def __init__(
        self,
        options: ServiceOptions,
        journal: Journal | None = None,
        notifier: Notifier | None = None,
        clock: Callable[[], float] = time.monotonic,
        companion: Companion | None = None,
    ) -> None:
        self.options = options
        self._companion = companion
        self.journal = journal or Journal()
        self.notifier = notifier or Notifier()
        self._clock = clock
        self._began = self._next_second = clock()
        self._next_chore = self._next_look = clock()
        self._reload_wanted = False
        self._preparing: Prepared[tuple[LoadedConfig, Engine]] | None = None
        self._check_wanted = False
        self._announced: object = None
        self._rejected = 0
        self._rates = InputRates(clock())
        self._start_count = StartCount(options.start_count)
        self.loaded = open_config(options.config, options.databases)
        engine = self._new_engine(self.loaded)
        self.orders = MountOrders(self)
        self._alarms = AlarmWatch(self.journal)
        self._lock = self._locked_folder()
        try:
            self._set_up(engine)
        except BaseException:
            self._release()
            raise

    def _set_up(self, engine: Engine) -> None:
        """What needs the state folder, and the bus."""
        self.calibration_store = self._new_calibration_store(self.loaded, engine)
        if self.calibration_store is not None:
            engine.pipeline.replace(self.calibration_store.restore(engine.pipeline.estimator))
            self._share_check(self.calibration_store, engine)
        self.dtc_store: DtcStore | None = None
        self.keys: AttemptStore | None = None
        self.uds = self._new_uds(self.loaded, engine)
        self.link = self._new_link(self.loaded, engine, self.uds)
        try:
            self.daemon = Daemon(engine, self.link, self._clock, self.uds)
            self.daemon.between = self._between
            path, is_needed = self.options.status_socket, self.options.socket_needed
            self.sockets = Sockets(path, is_needed, self.status, self.orders, self.journal)
        except ImucaldError:
            self.link.close()
            raise

    # starting ------------------------------------------------------------------------------

    def _locked_folder(self) -> FolderLock | None:
        """Have the state folder alone; a folder that takes no file is read all the same."""
        folder = self.options.state_folder
        if folder is None:
            return None
        try:
            lock = FolderLock(folder)
        except OSError as error:
            self.journal.say(f"{folder} cannot be locked: {error.strerror or error}", WARNING)
            return None
        clear_unfinished(folder)
        return lock

    def _release(self) -> None:
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    def _new_engine(self, loaded: LoadedConfig) -> Engine:
        return make_engine(loaded, self._snapshot, self._link_health)

    def _new_calibration_store(
        self, loaded: LoadedConfig, engine: Engine
    ) -> CalibrationStore | None:
        folder = self.options.state_folder
        if folder is None:
            return None
        store = StateStore(folder, state_key(loaded, engine.router, engine.model_key))
        return CalibrationStore(store, self.journal.say, self.options.save_period, self._clock)

    def _share_check(self, store: CalibrationStore, engine: Engine) -> None:
        """The sensor check of the last drive serves at once; a new one is saved with the mount."""
        for consumer in _checking(engine):
            consumer.restore_check(store.saved_check)
        store.sensor_check = self._saved_check

    def _saved_check(self) -> Mapping[str, Any] | None:
        return next((consumer.saved_check() for consumer in _checking(self.engine)), None)

    def _new_uds(self, loaded: LoadedConfig, engine: Engine) -> BusUds | None:
        if not loaded.config.diagnostics.enabled:
            return None
        # imported only where it is wanted: it loads OpenSSL (3.6 MiB) for keys
        from imucald.service.attempt_store import AttemptStore  # noqa: PLC0415
        from imucald.service.dtc_store import DtcStore  # noqa: PLC0415
        from imucald.service.uds_on_bus import bus_uds_for  # noqa: PLC0415

        if self.dtc_store is None:
            folder, key = self.options.state_folder, state_key(loaded, engine.router)
            path = None if folder is None else folder / f"{key.file_name}.troubles"
            self.dtc_store = DtcStore(path, self.journal.say, self._clock)
            self.keys = AttemptStore(folder and folder / "security.keys", self.journal.say)
        return bus_uds_for(self, loaded, engine, self._clock, self.dtc_store.memory, self.keys)

    def _new_link(self, loaded: LoadedConfig, engine: Engine, uds: BusUds | None) -> Link:
        options = self.options
        matches, own_ids = engine.router.matches, engine.output.can_ids
        if uds is not None:
            matches, own_ids = matches + uds.matches, own_ids | uds.own_ids
        return open_link(
            loaded,
            matches,
            own_ids,
            options.interface,
            options.channel,
            self._link_event,
        )

    # running -------------------------------------------------------------------------------

    @property
    def engine(self) -> Engine:
        """The engine that runs now (another one after a reload)."""
        return self.daemon.engine

    def run(self, seconds: float = float("inf")) -> None:
        """Loop until `stop`, or for so many seconds."""
        self.journal.say(f"listening on {self.link.interface} {self.link.channel}")
        self._tell_model()
        self.notifier.ready()
        end = self._clock() + seconds
        daemon, clock = self.daemon, self._clock
        while not daemon.stopping:
            daemon.step()
            now = clock()
            if now >= self._next_chore:
                self._next_chore = now + CHORE_S
                self._chores(now)
                if now >= end:
                    break

    def stop(self) -> None:
        """End the loop soon; safe in a signal handler."""
        self.daemon.stop()

    def ask_reload(self) -> None:
        """Read the configuration again soon; safe in a signal handler."""
        self._reload_wanted = True

    def close(self) -> None:
        """Save the state, let go of bus and socket."""
        self.notifier.stopping()
        self.sockets.close()
        self.link.close()  # first: nothing stale is sent while the disk takes its time
        if self.calibration_store is not None:
            self.calibration_store.close(self.engine.pipeline.estimator, self.engine.timebase.now)
        if self.dtc_store is not None:
            self.dtc_store.close()
        if self.keys is not None:
            self.keys.close()
        if self._companion is not None:
            self._companion.close()
        self._release()

    def _between(self) -> None:
        """Within a batch of frames: tell the watchdog, and whoever asks, that the loop goes on."""
        now = self._clock()
        if now >= self._next_look:
            self._next_look = now + CHORE_S
            self.notifier.feed()
            self.sockets.poll_status()

    def _chores(self, now: float) -> None:
        self.notifier.feed()
        self._go_on_reloading()
        if self._check_wanted:
            self._check_wanted = False
            if not self.check_sensors():
                self.journal.say("there is no sensor check without attitude", WARNING)
        self.sockets.poll()
        if now >= self._next_second:
            self._next_second = now + SECOND_S
            self._every_second(now)

    def _every_second(self, now: float) -> None:
        self._start_count.update(now - self._began)
        estimate = self._estimate()
        if self.calibration_store is not None:
            self.calibration_store.update(self.engine.pipeline.estimator, self.engine.timebase.now)
        if self.dtc_store is not None:
            self.dtc_store.update()
        self.notifier.status(status_line(estimate, str(self.link.state)))
        self._rates.update(self.engine.router.sample_counts, now)
        if self._companion is not None and self._companion.poll():
            self.journal.say("what serves the metrics has ended; all else goes on", WARNING)
        self._alarms.update(asdict(self.engine.health()), now - self._began)
        rejected = self.engine.router.rejected
        if (total := rejected.total()) > self._rejected:
            self._rejected = total
            text = ", ".join(f"{reason} {n}" for reason, n in sorted(rejected.items()))
            self.journal.seldom("rejected", f"rejected so far: {text}", WARNING)

    # reloading -----------------------------------------------------------------------------

    def reload(self) -> None:
        """Read the configuration again; the estimate goes on. A wrong one changes nothing."""
        self.notifier.reloading()
        self._take_over(Prepared.of(self._prepare))

    def _prepare(self) -> tuple[LoadedConfig, Engine]:
        """What a reload reads and parses, which may take long; nothing that runs is touched."""
        loaded = open_config(self.options.config, self.options.databases)
        return loaded, self._new_engine(loaded)

    def _go_on_reloading(self) -> None:
        """Begin a reload that was asked for, beside the loop; take over what is prepared."""
        if self._preparing is None:
            if self._reload_wanted:
                self._reload_wanted = False
                self.notifier.reloading()
                self._preparing = Prepared.beside(self._prepare)
        elif self._preparing.is_done:
            prepared, self._preparing = self._preparing, None
            self._take_over(prepared)

    def _take_over(self, prepared: Prepared[tuple[LoadedConfig, Engine]]) -> None:
        try:
            self._swap(*prepared.result())
            self.journal.say(f"{self.options.config} was read again", NOTICE)
            self._tell_model()
        except Exception as error:  # whatever it is: what runs goes on as it was
            kind = "" if isinstance(error, ImucaldError) else f"{type(error).__name__}: "
            for line in (str(error) or "no reason given").splitlines():
                self.journal.say(f"not reloaded: {kind}{line}", ERROR)
        self.notifier.ready()

    def _swap(self, loaded: LoadedConfig, engine: Engine) -> None:
        """Let another engine take the place of the running one; all of it, or nothing."""
        old, link, uds = self.engine, self.link, self.uds
        kept = self.dtc_store, self.keys
        try:
            if uds is None or loaded.config.diagnostics != self.loaded.config.diagnostics:
                uds = self._new_uds(loaded, engine)
            else:
                uds.check_identifiers(loaded, engine)
            if listens_otherwise(self.loaded, loaded, old, engine):
                link = self._new_link(loaded, engine, uds)
            engine.timebase, engine.pipeline.k = old.timebase, old.pipeline.k
            estimator, store = self._estimator_after(loaded, engine)
            engine.pipeline.replace(estimator)
            engine.output.prepare()
        except BaseException:
            self.dtc_store, self.keys = kept
            if link is not self.link:
                link.close()
            raise
        if store is not self.calibration_store and self.calibration_store is not None:
            self.calibration_store.end()
        self.calibration_store = store
        self.loaded = loaded
        self.daemon.engine = engine
        self.uds = uds
        self.daemon.serve(uds)
        self._rates.restart()
        self._rejected = 0
        if link is not self.link:
            self.link.close()
            self.link = self.daemon.link = link

    def _estimator_after(
        self, loaded: LoadedConfig, engine: Engine
    ) -> tuple[MountEstimator, CalibrationStore | None]:
        """The running estimator where it can stay; else a new one behind what is known.

        Beside it the store that is to keep it.
        """
        old, new = self.engine.pipeline.estimator, engine.pipeline.estimator
        key, before = state_key(loaded, engine.router), state_key(self.loaded, self.engine.router)
        other_model = engine.model_key != self.engine.model_key
        store = self.calibration_store
        if key != before or other_model:
            if store is not None:
                store.save_now(old, self.engine.timebase.now)
            store = self._new_calibration_store(loaded, engine)
            restored = new if store is None else store.restore(new)
            if store is not None:
                self._share_check(store, engine)
            if key != before or restored is not new:
                return restored, store  # another sensor or vehicle: what was found is not of it
            return behind_the_known(old, new), store
        if not other_model:
            for consumer in _checking(engine):
                consumer.restore_check(self._saved_check())
        if estimates_alike(self.loaded, loaded):
            old.gap()
            return old, store
        return behind_the_known(old, new), store

    # what diagnostics ask for ----------------------------------------------------------------

    @property
    def link_counters(self) -> LinkCounters:
        """What the bus link counts."""
        return self.link.counters

    @property
    def state_corrupt(self) -> bool | None:
        """Whether a state was found that could not be believed, and none was saved since."""
        store = self.calibration_store
        return None if store is None else bool(store.problems) and not store.writer.saves

    def check_sensors(self) -> bool:
        """Repeat the sensor check at the next rest; whether there is one to repeat (attitude)."""
        found = _checking(self.engine)
        for consumer in found:
            consumer.check_sensors()
        if found:
            self.journal.say("the sensors will be checked at the next rest", NOTICE)
        return bool(found)

    @property
    def sensors_checked(self) -> bool:
        """Whether the sensor check has been made."""
        return all(consumer.checked for consumer in _checking(self.engine))

    def ask_sensor_check(self) -> None:
        """Repeat the sensor check soon; safe within a signal handler."""
        self._check_wanted = True

    def forget_state(self) -> None:
        """Keep nothing of what was saved."""
        if self.calibration_store is not None:
            self.calibration_store.forget()

    def save_state(self) -> None:
        """Save the mount that is in force as it is now, held or not."""
        if self.calibration_store is not None:
            now = self.engine.timebase.now
            self.calibration_store.save_order(self.engine.pipeline.estimator, now)

    def tell_order(self, who: str, text: str) -> None:
        """Write what was done to the mount, and by whom, into the log."""
        if who == TESTER:  # may go on without end
            self.log_tester(f"{text} (by {who})")
        else:
            self.journal.say(f"{text} (by {who})", NOTICE)

    def log_tester(self, text: str) -> None:
        """Write what a tester did into the log."""
        self.journal.seldom(text.partition(":")[0], text, WARNING)

    # telling -------------------------------------------------------------------------------

    def _estimate(self) -> MountEstimate:
        return self.engine.pipeline.estimator.estimate()

    def _tell_model(self) -> None:
        """Say what of the model file is used, and what is not."""
        preprocessing = self.engine.preprocessing
        if preprocessing is not None:
            self.journal.say(preprocessing.words())
            for note in preprocessing.notes:
                self.journal.say(f"not used of the model: {note}", NOTICE)

    def _link_health(self) -> LinkHealth:
        return self.daemon.link_health() if hasattr(self, "daemon") else LinkHealth()

    def _link_event(self, event: LinkEvent) -> None:
        self.journal.say(event.text, INFO if event.kind in _QUIET_EVENTS else WARNING)

    def _snapshot(self, snapshot: Snapshot) -> None:
        """Say each change of state in one line."""
        estimate = snapshot.estimate
        if estimate.state is self._announced:
            return
        self._announced = estimate.state
        waiting = reasons_line(estimate.waiting_for)
        text = f"{estimate.state.name.lower()} at {snapshot.t:.1f} s"
        self.journal.say(text + (waiting and f" ({waiting})"), NOTICE)

    def result(self) -> dict[str, Any]:
        """Summary of the run (see docs/json.md), with the link's counters."""
        return run_result(self.engine, self.link)

    def _uds_status(self) -> dict[str, Any] | None:
        if self.uds is None or self.dtc_store is None:
            return None
        return self.uds.status() | {"dtc_memory": self.dtc_store.status()}

    def status(self) -> dict[str, Any]:
        """What `imucald status` shows; keys in docs/service.md."""
        engine = self.engine
        found = running_status(
            engine, self.link, self._rates, self.calibration_store, self.journal.dropped
        )
        return found | {
            "config": str(self.options.config),
            "vehicle": self.loaded.config.vehicle.id,
            "sensor": state_key(self.loaded, engine.router, engine.model_key).sensor,
            "uptime_s": round(self._clock() - self._began, 3),
            "held": self.orders.is_held,
            "diagnostics": self._uds_status(),
        }


def _checking(engine: Engine) -> list[ChecksSensors]:
    """What checks sensors on an engine: attitude, where it is on."""
    return [consumer for consumer in engine.consumers if isinstance(consumer, ChecksSensors)]
