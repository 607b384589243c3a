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
        self._preparing: Prepared[Read] | None = None
        self._clock = clock
        self._began = 0.0
        self._is_waiting_reported = self._is_long_reported = False

    def ask(self) -> None:
        """Request a reload. The call is safe in a signal handler."""
        self._is_requested = True

    def now(self) -> None:
        """Reload at once."""
        self._notifier.reloading()
        self._end(Prepared.run_now(self._read))

    def poll(self) -> None:
        """Start a requested reload in a thread. If a configuration has been read, apply it."""
        if self._preparing is None:
            if self._is_requested:
                self._is_requested = False
                self._notifier.reloading()
                self._preparing = Prepared.run_in_thread(self._read)
                self._began = self._clock()
                self._is_waiting_reported = self._is_long_reported = False
        elif self._preparing.is_done:
            prepared, self._preparing = self._preparing, None
            self._end(prepared)
        else:
            self._report_hanging(self._clock() - self._began)

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

    def _end(self, prepared: Prepared[Read]) -> None:
        try:
            self._take_over(prepared.result())
        except Exception as error:  # whatever it is: what runs goes on as it was
            kind = "" if isinstance(error, ImucaldError) else f"{type(error).__name__}: "
            for line in (str(error) or "no reason given").splitlines():
                self._journal.say(f"not reloaded: {kind}{line}", ERROR)
        self._notifier.ready()


Result = TypeVar("Result")


class Prepared(Generic[Result]):
    """The result or the exception of a function that runs now or in a thread."""

    def __init__(self) -> None:
        self.is_done = False
        self._found: Result | None = None
        self._error: Exception | None = None

    @classmethod
    def run_now(cls, work: Callable[[], Result]) -> Prepared[Result]:
        """Call the function now."""
        made = cls()
        made._do(work)
        return made

    @classmethod
    def run_in_thread(cls, work: Callable[[], Result]) -> Prepared[Result]:
        """Call the function in a thread. If no thread can be started, call the function now."""
        made = cls()
        try:
            threading.Thread(target=made._do, args=[work], name="prepare", daemon=True).start()
        except RuntimeError:  # the system has no thread left
            made._do(work)
        return made

    def _do(self, work: Callable[[], Result]) -> None:
        try:
            self._found = work()
        except Exception as error:
            self._error = error
        finally:
            self.is_done = True

    def result(self) -> Result:
        """Return the result of the function, or raise its exception.

        The function must have ended before this call.
        """
        if self._error is not None:
            raise self._error
        assert self._found is not None
        return self._found
