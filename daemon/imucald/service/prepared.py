"""Work that may take long, done by a thread, its result or error kept for later."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

Result = TypeVar("Result")


class Prepared(Generic[Result]):
    """What a function returned or raised."""

    def __init__(self) -> None:
        self.is_done = False
        self._found: Result | None = None
        self._error: Exception | None = None

    @classmethod
    def of(cls, work: Callable[[], Result]) -> Prepared[Result]:
        """Do it now."""
        made = cls()
        made._do(work)
        return made

    @classmethod
    def beside(cls, work: Callable[[], Result]) -> Prepared[Result]:
        """Have a thread do it; without one, it is done now."""
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
        """What was returned; raises what was raised. Only when it is done."""
        if self._error is not None:
            raise self._error
        assert self._found is not None
        return self._found
