"""Ctrl-C that never breaks into an import: that would wrap, print or swallow it."""

from __future__ import annotations

import signal
from types import FrameType

IMPORTING = "<frozen importlib._bootstrap"
"""File of the frames that import a module."""
AFTER_IMPORT_S = 0.02
"""In an import it is looked at again so soon."""


def interrupt(_: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt, after the import that runs: a signal handler of the main thread."""
    while frame is not None:
        if frame.f_code.co_filename.startswith(IMPORTING):
            signal.signal(signal.SIGALRM, interrupt)
            signal.setitimer(signal.ITIMER_REAL, AFTER_IMPORT_S)
            return
        frame = frame.f_back
    raise KeyboardInterrupt
