"""What the service reports of itself in short: the status line, and what the process takes."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path
from typing import Any

from imucald.core.angles import DEG_PER_RAD
from imucald.mount.estimate import ANGLES, MountEstimate
from imucald.mount.mount_words import VEHICLE_AXES, how_it_sits, plus_minus, reasons_line

NOT_SAVED: dict[str, Any] = {
    "folder": None,
    "generation": 0,
    "restored_at_start": False,
    "saves": 0,
    "failures": 0,
    "last_error": "",
    "to_be_forgotten": False,
    "problems": [],
    "remounts": 0,
}


def status_line(estimate: MountEstimate, link: str) -> str:
    """One line for `systemctl status`."""
    parts = [estimate.state.name.lower()]
    angles, std = estimate.angles, estimate.angle_std
    if angles is not None and std is not None:
        for name, angle, s in zip(ANGLES, angles, std, strict=True):
            spread = plus_minus(s * DEG_PER_RAD)
            known = f"{angle * DEG_PER_RAD:+.2f} {spread}" if spread != "-" else "not known"
            parts.append(f"{name} {known}")
        parts.append("± 95 %")
        if missing := _to_be_fine(estimate):
            parts.append(missing)
        if sits := how_it_sits(estimate):
            parts.append(sits)
    if waiting := reasons_line(estimate.waiting_for):
        parts.append(waiting)
    if link != "up":
        parts.insert(0, f"bus {link}")
    return "; ".join(parts)


def _to_be_fine(estimate: MountEstimate) -> str:
    """What states are judged by and is above its target; empty where nothing is."""
    std, targets = estimate.judged_std, estimate.targets
    if std is None or targets is None:
        return ""
    missing = [
        f"the {axis} below {plus_minus(fine * DEG_PER_RAD)} (now {plus_minus(s * DEG_PER_RAD)})"
        for axis, s, fine in zip(VEHICLE_AXES, std, targets.fine, strict=True)
        if not s < fine
    ]
    return f"to be fine: turn about {', about '.join(missing)}" if missing else ""


def process_figures() -> dict[str, Any]:
    """Memory, processor time, threads and open files of this process."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        files: int | None = len(os.listdir("/proc/self/fd"))  # noqa: PTH208
        rss: int | None = pages * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        rss, files = None, None
    return {
        "pid": os.getpid(),
        "rss_bytes": rss,
        "cpu_s": round(time.process_time(), 3),
        "threads": threading.active_count(),
        "open_files": files,
    }
