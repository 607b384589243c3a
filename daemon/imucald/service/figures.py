"""What the service tells of itself in short: the status line, and what the process takes."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path
from typing import Any

from imucald.core.angles import DEG_PER_RAD
from imucald.mount.estimate import ANGLES, MountEstimate
from imucald.mount.mount_words import half_width, how_it_sits, plus_minus, reasons_line

NOT_SAVED: dict[str, Any] = {
    "folder": None,
    "generation": 0,
    "restored_at_start": False,
    "saves": 0,
    "failures": 0,
    "last_error": "",
    "problems": [],
    "remounts": 0,
}


def status_line(estimate: MountEstimate, link: str) -> str:
    """One line for `systemctl status`."""
    parts = [estimate.state.name.lower()]
    angles, std, targets = estimate.angles, estimate.std, estimate.targets
    if angles is not None and std is not None:
        known = [
            (name, angle * DEG_PER_RAD, s * DEG_PER_RAD, i)
            for i, (name, angle, s) in enumerate(zip(ANGLES, angles, std, strict=True))
            if half_width(s * DEG_PER_RAD) is not None
        ]
        for name, angle, s, i in known:
            text = f"{name} {angle:+.2f} {plus_minus(s)}"
            if targets is not None and s >= (fine := targets.fine[i] * DEG_PER_RAD):
                text += f" (fine below {plus_minus(fine)})"
            parts.append(text)
        parts.append("± 95 %")
        if sits := how_it_sits(estimate):
            parts.append(sits)
    if waiting := reasons_line(estimate.waiting_for):
        parts.append(waiting)
    if link != "up":
        parts.insert(0, f"bus {link}")
    return "; ".join(parts)


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
