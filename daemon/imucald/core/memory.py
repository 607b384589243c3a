"""How much memory this process may take: what the machine has, or what its control group leaves."""

from __future__ import annotations

import os
from pathlib import Path

_GROUPS = Path("/sys/fs/cgroup")


def allowed_memory(own_group: Path = Path("/proc/self/cgroup"), groups: Path = _GROUPS) -> int:
    """Return bytes: the least of physical memory and MemoryMax of the groups around (cgroup v2)."""
    limits = [os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")]
    folder = groups / _unified(own_group).lstrip("/")
    for group in (folder, *folder.parents):
        try:
            limits.append(int((group / "memory.max").read_text()))
        except (OSError, ValueError):  # no such group from here, or "max"
            continue
        if group == groups:
            break
    return min(limits)


def _unified(own_group: Path) -> str:
    """The path of this process's group in the one hierarchy of cgroup v2."""
    try:
        lines = own_group.read_text().splitlines()
    except OSError:
        return ""
    return next((line.removeprefix("0::") for line in lines if line.startswith("0::")), "")
