"""A program that ends when the test process that started it does, however that ends."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

POLL_S = 0.2
URGENCY = "-15"
"""What runs guarded is an emulated machine whose tests have time limits. It stands for one with a
processor of its own: it comes before the host's other work, where we may say so, and stays on one
processor. (It has but one inside, and each of its system calls and page faults is a change from one
process to another, which between two processors takes up to four times as long.)"""


class Guarded:
    """A running command whose whole process group is ended by `end`, or by our own death."""

    def __init__(self, command: Sequence[str], console: Path) -> None:
        with console.open("wb") as output:
            self._guard = subprocess.Popen(
                [sys.executable, __file__, *command],
                stdin=subprocess.PIPE,  # closed by us, or by the system when we are no more
                stdout=output,
                stderr=subprocess.STDOUT,
            )
        self.pid = self._guard.pid

    def wait(self, limit: float) -> bool:
        """Wait until it has ended by itself, at most `limit` [s]; whether it has."""
        try:
            self._guard.wait(limit)
        except subprocess.TimeoutExpired:
            return False
        return True

    def end(self) -> None:
        """End it now, unless it has ended."""
        assert self._guard.stdin is not None
        self._guard.stdin.close()
        self._guard.wait()


def guard(command: Sequence[str]) -> None:
    """Run a command until it ends, or until nobody holds the other end of our standard input."""
    processors = sorted(os.sched_getaffinity(0))
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw") or 0)
    os.sched_setaffinity(0, {processors[-1 - worker % len(processors)]})
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=True)
    with contextlib.suppress(OSError):  # no scheduling by sessions here, or not for us to say
        Path(f"/proc/{process.pid}/autogroup").write_text(URGENCY)
    while process.poll() is None:
        if select.select([sys.stdin], [], [], POLL_S)[0]:  # closed: nothing is ever sent
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a Ctrl-C is for pytest, which then tells us
    guard(sys.argv[1:])
