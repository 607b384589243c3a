"""Loops of the program in a thread of a test, which ends with the test."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def in_a_thread(
    run: Callable[[], object], stop: Callable[[], object], limit: float = 5.0
) -> Iterator[threading.Thread]:
    """Run it beside the test; it must end within the limit [s] after `stop`."""
    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield thread
    finally:
        stop()
        thread.join(limit)
        assert not thread.is_alive()
