"""The service around the main loop: saved state, systemd, status, reload.

The main loop runs all these tasks. The tasks run at least every `CHORE_S`, with or without bus
traffic. The messages to systemd's watchdog therefore show that the loop that corrects frames still
runs.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from msgspec.structs import asdict

from imucald.can.link.link import Link
from imucald.config import LoadedConfig
from imucald.core.errors import ImucaldError
from imucald.runtime.engine import Engine
from imucald.runtime.flow import Flow, flow
from imucald.runtime.input_health import LinkHealth
from imucald.runtime.mount_orders import TESTER, MountOrders
from imucald.service.announcements import Announcements, say_idle_keys
from imucald.service.folder_lock import FolderInUseError, FolderLock
from imucald.service.journal import NOTICE, WARNING, Journal
from imucald.service.live import ClockWatch, Daemon
from imucald.service.notify import Notifier, StartCount
from imucald.service.parts import (
    Listeners,
    Parts,
    PartsMaker,
    ServiceOptions,
    attitude_of,
)
from imucald.service.recent_history import PERIOD_S, RecentHistory
from imucald.service.records import clear_unfinished
from imucald.service.reloading import Reloading
from imucald.service.running_status import InputRates, run_result, running_status, status_line
from imucald.service.saved_state import state_key
from imucald.service.status import Sockets

if TYPE_CHECKING:
    from imucald.service.listening import ServingProcess

CHORE_S = 0.1
"""Period of all tasks except the handling of frames [s]."""


class Service:
    """Runs the daemon of one configuration. Raises ConfigError or LinkError at the start."""

    def __init__(
        self,
        options: ServiceOptions,
        journal: Journal | None = None,
        notifier: Notifier | None = None,
        clock: Callable[[], float] = time.monotonic,
        companion: ServingProcess | None = None,
    ) -> None:
        """companion: the metrics process, which runs as long as the daemon."""
        self.options = options
        self._companion = companion
        self.journal = journal or Journal()
        self.notifier = notifier or Notifier()
        self._clock = clock
        self._began = self._next_second = clock()
        self._next_chore = self._next_look = clock()
        self._check_wanted = False
        self._says_unlocked = self._is_displaced = False
        self._rates = InputRates(clock())
        self._start_count = StartCount(options.start_count)
        self.orders = MountOrders(self)
        self._announcements = own = Announcements(self.journal)
        self.clock_watch = ClockWatch()
        self._history, self._next_row = RecentHistory(), clock()
        listeners = Listeners(own.snapshot, own.link_event, self._link_health, self.journal.say)
        self._maker = PartsMaker(self, options, listeners, clock)
        self._reloading = Reloading(
            self._maker.read, self._take_over, self.journal, self.notifier, clock
        )
        loaded, engine = self._maker.read()
        self._lock = self._locked_folder()
        try:
            self._set_up(loaded, engine)
        except BaseException:
            self._release()
            raise

    def _set_up(self, loaded: LoadedConfig, engine: Engine) -> None:
        """Set up the parts that need the state folder, and the bus."""
        say_idle_keys(loaded, self.journal)
        self.parts = self._maker.first(loaded, engine)
        try:
            self.daemon = Daemon(engine, self.link, self._clock, self.parts.diagnostics.uds)
            self.daemon.between = self._between
            path, is_needed = self.options.status_socket, self.options.socket_needed
            self.sockets = Sockets(
                path, is_needed, self.status, self.orders, self.journal, self._history.as_json
            )
        except ImucaldError:
            self.link.close()
            raise

    # starting ------------------------------------------------------------------------------

    def _locked_folder(self) -> FolderLock | None:
        """Lock the state folder for this daemon. If the folder cannot be locked, the saved state is
        still read."""
        folder = self.options.state_folder
        if folder is None:
            return None
        try:
            lock = FolderLock(folder)
        except OSError as error:
            text = (
                f"the folder {folder} cannot be locked: {error.strerror or error}; this is "
                "tried again every second"
            )
            if not self._says_unlocked:
                self.journal.say(text, WARNING)
            self._says_unlocked = True
            return None
        if self._says_unlocked:
            self._says_unlocked = False
            self.journal.say(f"{folder} is locked now", NOTICE)
        clear_unfinished(folder)
        return lock

    def _keep_locked(self) -> None:
        """Lock the folder if it could not be locked before, or if it was deleted and created again.
        Raises FolderInUseError if another daemon was faster; this daemon then saves nothing more.
        """
        try:
            if self._lock is None:
                self._lock = self._locked_folder()
            elif self._lock.renew():
                text = (
                    f"the folder {self.options.state_folder} was deleted; it is created and "
                    "locked again"
                )
                self.journal.say(text, WARNING)
        except FolderInUseError:
            self._is_displaced = True
            raise
        except OSError:  # it is tried again; a save that fails is reported
            return

    def _release(self) -> None:
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    # running -------------------------------------------------------------------------------

    @property
    def loaded(self) -> LoadedConfig:
        """The present configuration. A reload replaces it together with all other `parts`."""
        return self.parts.loaded

    @property
    def engine(self) -> Engine:
        """The engine that runs now."""
        return self.parts.engine

    @property
    def link(self) -> Link:
        """The bus."""
        return self.parts.link

    def run(self, seconds: float = float("inf")) -> None:
        """Run the loop until `stop` is called, for at most `seconds`."""
        self.journal.say(f"listening on {self.link.interface} {self.link.channel}")
        self._announcements.model(self.engine)
        self.notifier.ready()
        end = self._clock() + seconds
        daemon, clock = self.daemon, self._clock
        while not daemon.stopping:
            daemon.serve_once()
            now = clock()
            if now >= self._next_chore:
                self._next_chore = now + CHORE_S
                self._chores(now)
                if now >= end:
                    break

    def stop(self) -> None:
        """Request the end of the loop. The call is safe in a signal handler."""
        self.daemon.stop()

    def ask_reload(self) -> None:
        """Request a reload of the configuration. The call is safe in a signal handler."""
        self._reloading.ask()

    def reload(self) -> None:
        """Read the configuration again. The estimate continues. If the new configuration is wrong,
        nothing changes.
        """
        self._reloading.now()

    def _take_over(self, read: tuple[LoadedConfig, Engine]) -> None:
        """Replace all running parts by new parts, or none of them."""
        before = self.parts
        self.parts = now = self._maker.after(before, *read)
        self.daemon.engine, self.daemon.link = now.engine, now.link
        self.daemon.serve(now.diagnostics.uds)
        self._let_go(before, now)
        self.journal.say(f"{self.options.config} was read again", NOTICE)
        say_idle_keys(read[0], self.journal)
        self._announcements.model(now.engine)

    def _let_go(self, before: Parts, now: Parts) -> None:
        """End the parts that were replaced. A failure here does not undo the replacement."""
        store, ends = before.calibration_store, list[Callable[[], None]]()
        if store is not None and store is not now.calibration_store:
            ends.append(store.end)
        if before.link is not now.link:
            ends.append(before.link.close)
        for end in ends:
            try:
                end()
            except Exception as error:  # of a driver, say
                text = (
                    f"the tasks from before the reload could not be stopped ({type(error).__name__}"
                )
                self.journal.say(f"{text}: {error})", WARNING)

    def close(self) -> None:
        """Save the state, and close bus and sockets."""
        self.notifier.stopping()
        self.sockets.close()
        self.link.close()  # first: nothing stale is sent while the disk takes its time
        store, engine = self.parts.calibration_store, self.engine
        if not self._is_displaced:  # else the folder is another daemon's
            if store is not None:
                store.close(engine.pipeline.estimator, engine.timebase.now)
            self.parts.diagnostics.close()
        if self._companion is not None:
            self._companion.close()
        self._release()

    def _between(self) -> None:
        """Notify the watchdog and answer status clients during a long batch of frames."""
        now = self._clock()
        if now >= self._next_look:
            self._next_look = now + CHORE_S
            self.notifier.feed()
            self.sockets.poll_status()

    def _chores(self, now: float) -> None:
        self.notifier.feed()
        self._history.tick(self.engine)
        self._reloading.poll()
        if self._check_wanted:
            self._check_wanted = False
            if not self.check_sensors():
                self.journal.say(
                    "there is no sensor check, since 'attitude' is not enabled in the "
                    "configuration",
                    WARNING,
                )
        self.sockets.poll()
        if now >= self._next_second:
            self._next_second = now + 1.0
            self._every_second(now)

    def _every_second(self, now: float) -> None:
        self._start_count.update(now - self._began)
        self._keep_locked()
        engine, store = self.engine, self.parts.calibration_store
        estimate = engine.pipeline.estimator.estimate()
        if store is not None:
            store.update(engine.pipeline.estimator, engine.timebase.now)
        self.parts.diagnostics.update()
        self.notifier.status(status_line(estimate, str(self.link.state)))
        self._rates.update(engine.router.sample_counts, now)
        if self._companion is not None and self._companion.poll():
            self.journal.say(
                "the metrics process has ended; the daemon continues without it", WARNING
            )
        self._announcements.update(engine, self.link.counters.late, now - self._began)
        if now >= self._next_row:
            self._next_row = now + PERIOD_S
            self._history.end_row(engine, self._flow().kind)
        if (step := self.clock_watch.look()) is not None:
            text = f"the clock of the system was set by {step:+.1f} s: times in this log jump"
            self.journal.seldom("clock", text, NOTICE)

    # what diagnostics and orders ask for ----------------------------------------------------

    @property
    def state_corrupt(self) -> bool | None:
        """True if the saved state was invalid at the start and no state has been saved since then.
        None if no state is kept."""
        store = self.parts.calibration_store
        return None if store is None else bool(store.problems) and not store.writer.saves

    def check_sensors(self) -> bool:
        """Repeat the sensor check of the attitude at the next standstill. Return whether there is a
        sensor check.
        """
        attitude = attitude_of(self.engine)
        if attitude is None:
            return False
        attitude.check_sensors()
        self.journal.say("the sensors will be checked at the next stop", NOTICE)
        return True

    @property
    def sensors_checked(self) -> bool:
        """True if the sensor check has been completed."""
        attitude = attitude_of(self.engine)
        return attitude is None or attitude.checked

    def ask_sensor_check(self) -> None:
        """Request the sensor check. The call is safe in a signal handler."""
        self._check_wanted = True

    def forget_state(self) -> str:
        """Forget the saved state. Return the reason if the disk cannot be changed now, or ""."""
        store = self.parts.calibration_store
        return "" if store is None else store.forget()

    @property
    def state_forgotten(self) -> bool:
        """True if the next start loads no forgotten state."""
        store = self.parts.calibration_store
        return store is None or store.store.is_forgotten

    def save_state(self) -> str:
        """Save the present mount, also if it is held. Return the reason if the disk cannot be
        written, or ""."""
        store, engine = self.parts.calibration_store, self.engine
        if store is None:
            return ""
        return store.save_order(engine.pipeline.estimator, engine.timebase.now)

    def log_order(self, who: str, text: str) -> None:
        """Log an order and the person who gave the order."""
        if who == TESTER:  # may go on without end
            self.log_tester(f"{text} (by {who})")
        else:
            self.journal.say(f"{text} (by {who})", NOTICE)

    def log_tester(self, text: str) -> None:
        """Log an action of a diagnostic tester, at a limited rate."""
        self.journal.seldom(text.partition(":")[0], text, WARNING)

    # what it reports -----------------------------------------------------------------------

    def _link_health(self) -> LinkHealth:
        return self.daemon.link_health() if hasattr(self, "daemon") else LinkHealth()

    def result(self) -> dict[str, Any]:
        """Return the summary of the run (see docs/json.md), with the link's counters."""
        return run_result(self.engine, self.link)

    def status(self) -> dict[str, Any]:
        """Return the content of `imucald status`; keys in docs/service.md."""
        engine, store = self.engine, self.parts.calibration_store
        found = running_status(engine, self.link, self._rates, store)
        found["process"] |= {
            "log_lines_dropped": self.journal.dropped,
            "clock_set": self.clock_watch.count,
        }
        found |= {
            "config": str(self.options.config),
            "vehicle": self.loaded.config.vehicle.id,
            "sensor": state_key(self.loaded, engine.router, engine.model_key).sensor,
            "uptime_s": round(self._clock() - self._began, 3),
            "silent_s": round(self.daemon.silent_s, 3),
            "held": self.orders.is_held,
            "diagnostics": self.parts.diagnostics.status(),
        }
        return found | {"flow": asdict(flow(found))}

    def _flow(self) -> Flow:
        """Return the present kind of the corrected frames (`runtime.flow`). The method is faster
        than computing the whole status."""
        pipeline = self.engine.pipeline
        return flow(
            {
                "state": pipeline.estimator.state.name.lower(),
                "quality": pipeline.quality,
                "link": {"state": str(self.link.state)},
                "health": asdict(self.engine.health()),
                "signals": self.engine.router.sample_counts,
                "uptime_s": self._clock() - self._began,
                "silent_s": self.daemon.silent_s,
            }
        )
