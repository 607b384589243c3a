"""What a process says to the Linux kernel about itself: whom to die with, how much to take."""

from __future__ import annotations

import ctypes
import os
import resource
import signal

PR_SET_PDEATHSIG = 1
"""linux/prctl.h"""

FOR_CHILDREN = {
    "OMP_NUM_THREADS": "1",  # the logs are what runs in parallel
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "ARROW_DEFAULT_MEMORY_POOL": "system",  # the others map a GiB at once, which the limit counts
}
"""For the environment of children."""

_libc = ctypes.CDLL(None, use_errno=True)


def die_with(parent: int) -> None:
    """Let the kernel kill this process when its parent, of that pid, ends."""
    _libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:  # it ended before the line above
        os._exit(1)


def limit_memory(beside: int) -> None:
    """Let this process map so many bytes more than it has mapped now; no core files."""
    with open("/proc/self/statm", encoding="ascii") as file:  # noqa: PTH123 - a lean start
        mapped = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (mapped + beside, mapped + beside))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
