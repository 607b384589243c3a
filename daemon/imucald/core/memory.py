"""Memory that this process may use, from the limits of machine, control group and process."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]

_GROUPS = Path("/sys/fs/cgroup")


def allowed_memory(own_group: Path = Path("/proc/self/cgroup"), groups: Path = _GROUPS) -> int:
    """Return the allowed memory [bytes].

    The result is the smallest of physical memory, the process's limits of address space and data
    (`ulimit`), and MemoryMax of the surrounding groups (cgroup v2).
    """
    if resource is None:
        # Windows: the smallest memory of present desktop computers
        return 4 * 2**30
    limits = [os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")]
    own = (resource.getrlimit(kind)[0] for kind in (resource.RLIMIT_AS, resource.RLIMIT_DATA))
    limits += [limit for limit in own if limit != resource.RLIM_INFINITY]
    folder = groups / _unified(own_group).lstrip("/")
    for group in (folder, *folder.parents):
        try:
            limits.append(int((group / "memory.max").read_text()))
        except (OSError, ValueError):  # no such group from here, or "max"
            continue
        if group == groups:
            break
    return min(limits)


def limit_own(memory: int, seconds: int) -> None:
    """Limit this process's data [bytes] and processor time [s], if the system supports it."""
    if resource is None:
        return
    for kind, value in ((resource.RLIMIT_DATA, memory), (resource.RLIMIT_CPU, seconds)):
        with contextlib.suppress(ValueError, OSError):  # there is a lower one
            resource.setrlimit(kind, (value, value))


def _unified(own_group: Path) -> str:
    """Return the path of this process's control group in the unified hierarchy (cgroup v2)."""
    try:
        lines = own_group.read_text().splitlines()
    except OSError:
        return ""
    return next((line.removeprefix("0::") for line in lines if line.startswith("0::")), "")
