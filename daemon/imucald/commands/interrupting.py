"""Handle Ctrl-C so that it never interrupts an import or `copyreg`.

An import would wrap, print or ignore the exception. `copyreg`, which every `deepcopy` of a frame
uses, would ignore it. SIGTERM and SIGHUP (closed terminal) are handled in the same way. A command
that receives one of these signals cleans up as after Ctrl-C. Then the command ends with this
signal, as the sender expects.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import sys
from types import FrameType

UNSAFE = frozenset({
    "importlib._bootstrap", "importlib._bootstrap_external",
    "_frozen_importlib", "_frozen_importlib_external",  # the same, early
    "copyreg",
})  # fmt: skip
"""Modules whose functions would catch and lose a KeyboardInterrupt."""
NEXT_ATTEMPT_S = 0.02
"""Time until the next attempt to raise KeyboardInterrupt if a function of an unsafe module is
running [s]."""


def interrupt(_: int, frame: FrameType | None) -> None:
    """Signal handler of the main thread: raise KeyboardInterrupt, as soon as no function of
    `UNSAFE` is running."""
    while frame is not None:
        if frame.f_globals.get("__name__") in UNSAFE:
            if not hasattr(signal, "setitimer"):  # Windows
                break
            signal.signal(signal.SIGALRM, interrupt)
            signal.setitimer(signal.ITIMER_REAL, NEXT_ATTEMPT_S)
            return
        frame = frame.f_back
    raise KeyboardInterrupt


class _Asked:
    """The signal that requested the end of this process; 0 if there was none."""

    to_end = 0


def terminate(number: int, frame: FrameType | None) -> None:
    """Signal handler of the main thread: interrupt, clean up, and end with the signal."""
    _Asked.to_end = number
    interrupt(number, frame)


def ending_signal() -> int:
    """The signal that requested the end of this process; 0 if there was none."""
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
