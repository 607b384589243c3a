"""Reading the configuration again: prepared beside the loop, taken over in one of its turns."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

from imucald.core.errors import ImucaldError
from imucald.service.journal import ERROR, Journal
from imucald.service.notify import Notifier
from imucald.service.prepared import Prepared

Read = TypeVar("Read")


class Reloading(Generic[Read]):
    """A reload from its request to its end. A failure is reported, and what runs goes on as it was.

    read: reads and parses, which may take long; touches nothing that runs. take_over: lets what was
    read take the place of what runs, all of it or nothing.
    """

    def __init__(
        self,
        read: Callable[[], Read],
        take_over: Callable[[Read], None],
        journal: Journal,
        notifier: Notifier,
    ) -> None:
        self._read, self._take_over = read, take_over
        self._journal, self._notifier = journal, notifier
        self._is_requested = False
        self._preparing: Prepared[Read] | None = None

    def ask(self) -> None:
        """Reload soon; safe in a signal handler."""
        self._is_requested = True

    def now(self) -> None:
        """Reload at once."""
        self._notifier.reloading()
        self._end(Prepared.of(self._read))

    def poll(self) -> None:
        """Begin a reload that was asked for, beside the loop; take over what is prepared."""
        if self._preparing is None:
            if self._is_requested:
                self._is_requested = False
                self._notifier.reloading()
                self._preparing = Prepared.beside(self._read)
        elif self._preparing.is_done:
            prepared, self._preparing = self._preparing, None
            self._end(prepared)

    def _end(self, prepared: Prepared[Read]) -> None:
        try:
            self._take_over(prepared.result())
        except Exception as error:  # whatever it is: what runs goes on as it was
            kind = "" if isinstance(error, ImucaldError) else f"{type(error).__name__}: "
            for line in (str(error) or "no reason given").splitlines():
                self._journal.say(f"not reloaded: {kind}{line}", ERROR)
        self._notifier.ready()
