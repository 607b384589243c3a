"""Settings of a process in the Linux kernel: end the process with its parent, and limit its
memory."""

from __future__ import annotations

import ctypes
import os
import resource
import signal

PR_SET_PDEATHSIG = 1
"""Constant of linux/prctl.h."""

FOR_CHILDREN = {
    "OMP_NUM_THREADS": "1",  # logs run in parallel, not their arithmetic
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "ARROW_DEFAULT_MEMORY_POOL": "system",  # other pools map 1 GiB at once
}
"""Environment variables for child processes."""

_libc = ctypes.CDLL(None, use_errno=True)


def die_with(parent: int) -> None:
    """Let the kernel kill this process when its parent ends. parent: its process id."""
    _libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:  # the parent ended before the line above
        os._exit(1)


def limit_memory(beside: int) -> None:
    """Limit the mapped memory of this process to its present size plus `beside` bytes. Disable core
    files."""
    with open("/proc/self/statm", encoding="ascii") as file:  # noqa: PTH123 - a lean start
        mapped = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (mapped + beside, mapped + beside))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
