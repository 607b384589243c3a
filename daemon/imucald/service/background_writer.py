"""A thread that writes saved data, so that the main loop never waits for a disk.

No exception of a save ends the thread. A failure is counted and shown in the status. The save is
tried again until it succeeds or newer data replace the content.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from imucald.service.journal import WARNING

RETRY_S = 10.0
"""Time until a failed save is tried again [s]."""

Say = Callable[[str, int], None]
"""Function that takes a log line and its priority."""
Content = TypeVar("Content")


class StateWriter(Generic[Content]):
    """A thread that saves the newest content passed to `put`. The first content starts the thread.

    save: function that writes a content; it may raise any exception. title: name of the content in
    the log, such as "the state". say: function that takes log lines (see `report`). retry: see
    `RETRY_S`.
    """

    def __init__(
        self, save: Callable[[Content], object], title: str, say: Say, retry: float = RETRY_S
    ) -> None:
        self.saves = 0
        self.failures = 0
        self.last_error = ""
        """Reason why the last attempt to save failed; empty if the attempt succeeded."""
        self._save = save
        self._title = title
        self._say = say
        self._retry = retry
        self._next: Content | None = None
        self._not_before = 0.0  # monotonic; a failed content waits until then
        self._busy = False
        self._discarded = False  # while busy: the content being written is no longer wanted
        self._ended = False
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None
        self._reported = ""

    def put(self, content: Content) -> None:
        """Request that `content` is saved soon. Content that still waits is replaced.

        The call never waits for the disk.
        """
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
        """Write the waiting content at once, for at most `limit` [s]. Return whether all content is
        written.
        """
        with self._changed:
            self._not_before = 0.0
            self._changed.notify_all()
            self._changed.wait_for(lambda: not self._busy and not self._is_due(), limit)
            return self._next is None and not self._busy

    def discard(self) -> None:
        """Drop the waiting content, and do not retry the content that is being written now."""
        with self._changed:
            self._next = None
            self._discarded = True
            self._changed.notify_all()

    def close(self, limit: float) -> bool:
        """Write the waiting content and end the thread, within `limit` [s]. Return whether all
        content is written.
        """
        done = self.flush(limit)
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        return done

    def report(self) -> None:
        """Log once that saving fails, and once that saving works again. The main loop calls this
        method."""
        error = self.last_error
        if error != self._reported:
            self._reported = error
            text = f"{self._title} cannot be saved: {error}; continuing without it"
            self._say(text if error else f"{self._title} can be saved again", WARNING)

    def status(self) -> dict[str, Any]:
        """Return the number of saves, the number of failures and the last error, for the status."""
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
