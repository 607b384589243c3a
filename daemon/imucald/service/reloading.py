"""Reload of the configuration. A thread reads the new configuration; the main loop applies it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Generic, TypeVar

from imucald.core.errors import ImucaldError
from imucald.service.journal import ERROR, WARNING, Journal
from imucald.service.notify import Notifier

Read = TypeVar("Read")

LONG_S = 30.0
"""A reload that takes longer than this is reported [s]. Reading a large database takes up to 10 s
per MB.
"""


class Reloading(Generic[Read]):
    """A reload from its request to its end.

    A failure is reported, and the running parts stay unchanged.

    read: function that reads and parses the configuration. The function may take long, and it does
    not change the running parts. take_over: function that replaces all running parts by the new
    parts, or none of them. clock: monotonic [s].
    """

    def __init__(
        self,
        read: Callable[[], Read],
        take_over: Callable[[Read], None],
        journal: Journal,
        notifier: Notifier,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._read, self._take_over = read, take_over
        self._journal, self._notifier = journal, notifier
        self._is_requested = False
        self._read_results: list[Read | Exception] | None = None
        """Result of the thread that reads; empty while it reads, None if there is no thread."""
        self._clock = clock
        self._began = 0.0
        self._is_waiting_reported = self._is_long_reported = False

    def ask(self) -> None:
        """Request a reload. The call is safe in a signal handler."""
        self._is_requested = True

    def now(self) -> None:
        """Reload at once."""
        self._notifier.reloading()
        self._end(self._result())

    def poll(self) -> None:
        """Start a requested reload in a thread. If a configuration has been read, apply it."""
        results = self._read_results
        if results is None:
            if self._is_requested:
                self._is_requested = False
                self._notifier.reloading()
                self._began = self._clock()
                self._is_waiting_reported = self._is_long_reported = False
                self._begin_reading()
        elif results:
            self._read_results = None
            self._end(results[0])
        else:
            self._report_hanging(self._clock() - self._began)

    def _begin_reading(self) -> None:
        results = self._read_results = []
        thread = threading.Thread(
            target=lambda: results.append(self._result()), name="prepare", daemon=True
        )
        try:
            thread.start()
        except RuntimeError:  # the system has no thread left
            results.append(self._result())

    def _result(self) -> Read | Exception:
        try:
            return self._read()
        except Exception as error:
            return error
        except BaseException as error:  # of a tester's module, say: the thread must give a result
            return ImucaldError(f"{type(error).__name__}: {error}")

    def _report_hanging(self, seconds: float) -> None:
        """Log that a reload takes long, or that a new reload waits for it. Each text is logged
        once."""
        reading = f"the configuration is still being read after {seconds:.0f} s"
        if self._is_requested and not self._is_waiting_reported:
            self._is_waiting_reported = True
            self._journal.say(f"the reload must wait: {reading}", WARNING)
        if seconds > LONG_S and not self._is_long_reported:
            self._is_long_reported = True
            text = (
                f"{reading}: perhaps a disk or network drive does not answer. The daemon "
                "continues with the old configuration. Restart it to read the new one"
            )
            self._journal.say(text, WARNING)

    def _end(self, result: Read | Exception) -> None:
        try:
            if isinstance(result, Exception):
                raise result
            self._take_over(result)
        except Exception as error:  # whatever it is: what runs goes on as it was
            kind = "" if isinstance(error, ImucaldError) else f"{type(error).__name__}: "
            for line in (str(error) or "no reason given").splitlines():
                self._journal.say(f"not reloaded: {kind}{line}", ERROR)
        self._notifier.ready()
