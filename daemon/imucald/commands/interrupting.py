"""Ctrl-C that never breaks into an import: that would wrap, print or swallow it.

SIGTERM and SIGHUP (the terminal is closed) likewise: a command that one of them ends tidies up as
after Ctrl-C, and then dies of it, as who sent it expects.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import sys
from types import FrameType

IMPORTING = "<frozen importlib._bootstrap"
"""File of the frames that import a module."""
AFTER_IMPORT_S = 0.02
"""In an import it is looked at again so soon."""


def interrupt(_: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt, after the import that runs: a signal handler of the main thread."""
    while frame is not None:
        if frame.f_code.co_filename.startswith(IMPORTING):
            if not hasattr(signal, "setitimer"):  # Windows
                break
            signal.signal(signal.SIGALRM, interrupt)
            signal.setitimer(signal.ITIMER_REAL, AFTER_IMPORT_S)
            return
        frame = frame.f_back
    raise KeyboardInterrupt


class _Asked:
    """The signal that has asked this process to end; 0: none."""

    to_end = 0


def terminate(number: int, frame: FrameType | None) -> None:
    """Interrupt, and die of the signal once all is tidied up: a handler of the main thread."""
    _Asked.to_end = number
    interrupt(number, frame)


def ending_signal() -> int:
    """The signal that has asked this process to end; 0: none."""
    return _Asked.to_end


@atexit.register  # the first one is the last one to be called
def _die() -> None:
    if not _Asked.to_end:
        return
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    signal.signal(_Asked.to_end, signal.SIG_DFL)
    os.kill(os.getpid(), _Asked.to_end)
