"""The one thread that writes: the loop hands over what to save, and never waits for a disk.

Nothing that a save raises ends it. A failure is counted, kept for the status and tried again, until
it succeeds or something newer is to be saved.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from imucald.service.journal import WARNING

RETRY_S = 10.0
"""What could not be saved is tried again after so long [s]."""

Say = Callable[[str, int], None]
"""Takes a line for the log and its priority."""
Content = TypeVar("Content")


class StateWriter(Generic[Content]):
    """A thread that saves the newest content it was given; started with the first.

    save: writes a content, or raises whatever it likes. title: what the log calls it, as in
    "the state". say: takes lines for the log (see `report`). retry: see `RETRY_S`.
    """

    def __init__(
        self, save: Callable[[Content], object], title: str, say: Say, retry: float = RETRY_S
    ) -> None:
        self.saves = 0
        self.failures = 0
        self.last_error = ""
        """Why the last attempt failed; empty when it did not."""
        self._save = save
        self._title = title
        self._say = say
        self._retry = retry
        self._next: Content | None = None
        self._not_before = 0.0  # monotonic; a failed content waits until then
        self._busy = False
        self._discarded = False  # while busy: what is being written is not wanted any more
        self._ended = False
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None
        self._reported = ""

    def put(self, content: Content) -> None:
        """Have this saved soon; what still waits is replaced. Never blocks for the disk."""
        with self._changed:
            self._next = content
            self._not_before = 0.0
            self._changed.notify_all()
        if self._thread is None:
            thread = threading.Thread(target=self._run, name="state", daemon=True)
            try:
                thread.start()
            except RuntimeError as error:  # the system has no thread left; the next `put` tries
                self._count_failure(error)
            else:
                self._thread = thread

    def flush(self, limit: float) -> bool:
        """Try what waits at once, for at most `limit` [s]; return whether all is written."""
        with self._changed:
            self._not_before = 0.0
            self._changed.notify_all()
            self._changed.wait_for(lambda: not self._busy and not self._is_due(), limit)
            return self._next is None and not self._busy

    def discard(self) -> None:
        """Let go of what waits, and never try again what is being written now."""
        with self._changed:
            self._next = None
            self._discarded = True
            self._changed.notify_all()

    def close(self, limit: float) -> bool:
        """Write what waits and end the thread, within `limit` [s]; whether all is written."""
        done = self.flush(limit)
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        return done

    def report(self) -> None:
        """Say that saving fails, and that it works again, once each; called by the loop."""
        error = self.last_error
        if error != self._reported:
            self._reported = error
            text = f"{self._title} cannot be saved: {error}; continuing without it"
            self._say(text if error else f"{self._title} can be saved again", WARNING)

    def status(self) -> dict[str, Any]:
        """Saves, failures, and the last error, for the status."""
        return {"saves": self.saves, "failures": self.failures, "last_error": self.last_error}

    def _is_due(self) -> bool:
        return self._next is not None and time.monotonic() >= self._not_before

    def _run(self) -> None:
        while True:
            with self._changed:
                while not self._is_due():
                    if self._ended:
                        return
                    wait = None if self._next is None else self._not_before - time.monotonic()
                    self._changed.wait(wait)
                content, self._next = self._next, None
                self._busy, self._discarded = True, False
            assert content is not None
            is_saved = self._try(content)
            with self._changed:
                self._busy = False
                if not is_saved and self._next is None and not self._discarded:
                    self._next = content
                    self._not_before = time.monotonic() + self._retry
                self._changed.notify_all()

    def _try(self, content: Content) -> bool:
        try:
            self._save(content)
        except BaseException as error:  # whatever it is: the thread must live on
            self._count_failure(error)
            return False
        self.saves += 1
        self.last_error = ""
        return True

    def _count_failure(self, error: BaseException) -> None:
        self.failures += 1
        kind, text = type(error).__name__, str(error)
        if isinstance(error, OSError):
            self.last_error = error.strerror or text or kind
        else:
            self.last_error = f"{kind}: {text}" if text else kind
