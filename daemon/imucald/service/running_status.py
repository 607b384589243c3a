"""Status of a running service: as JSON for `imucald status` (keys in docs/service.md), and as one
line. The resources of the process are part of the status.
"""

from __future__ import annotations

import dataclasses
import os
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from msgspec.structs import asdict

from imucald import __version__
from imucald.can.link.link import Link
from imucald.core.angles import DEG_PER_RAD
from imucald.mount.estimate import ANGLES, MountEstimate
from imucald.mount.mount_words import VEHICLE_AXES, how_it_sits, plus_minus, reasons_line
from imucald.runtime.engine import Engine
from imucald.runtime.summary import RunCounts, summary
from imucald.service.calibration_store import CalibrationStore


class InputRates:
    """Number of samples per second of each channel, measured between two calls of `update`."""

    def __init__(self, now: float) -> None:
        self._rates: dict[str, float] = {}
        self._counted: dict[str, int] = {}
        self._at = now

    def update(self, counts: Mapping[str, int], now: float) -> None:
        """Update the rates. counts: number of samples so far, by channel. now: monotonic [s]."""
        span = max(now - self._at, 1e-9)
        self._rates = {c: (n - self._counted.get(c, 0)) / span for c, n in counts.items()}
        self._counted, self._at = dict(counts), now

    def rate_of(self, channel: str) -> float:
        """Return the rate of a channel [1/s]."""
        return self._rates.get(channel, 0.0)


def run_result(engine: Engine, link: Link) -> dict[str, Any]:
    """Return the summary of the run (keys in docs/json.md) with the counters of the link."""
    counts = RunCounts(link.counters.received, engine.router.used, engine.router.rejected)
    found = summary(engine, counts, engine.timebase.now)
    found["link"] = dataclasses.asdict(link.counters)
    return found


def running_status(
    engine: Engine, link: Link, rates: InputRates, store: CalibrationStore | None
) -> dict[str, Any]:
    """Return the summary of the run so far, and the status of engine, bus, saved state and
    process."""
    found = run_result(engine, link)
    for channel, row in found["signals"].items():
        row["rate_hz"] = round(rates.rate_of(channel), 3)
    found["link"] |= {
        "state": str(link.state),
        "interface": link.interface,
        "channel": link.channel,
    }
    return found | {
        "version": __version__,
        "quality": engine.pipeline.quality,
        "health": asdict(engine.health()),
        "frames_given_out": engine.sent,
        "saved_state": NOT_SAVED if store is None else store.status(),
        "process": process_figures(),
    }


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
    """Return one line for `systemctl status`."""
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
    """Return a text with the mount errors that are too large for *fine*, and their limits; empty if
    all errors are small enough."""
    std, targets = estimate.judged_std, estimate.targets
    if std is None or targets is None:
        return ""
    missing = [
        f"the {axis} below {plus_minus(fine * DEG_PER_RAD)} (now {plus_minus(s * DEG_PER_RAD)})"
        for axis, s, fine in zip(VEHICLE_AXES, std, targets.fine, strict=True)
        if not s < fine
    ]
    return f"still needed for fine: error about {', about '.join(missing)}" if missing else ""


def process_figures() -> dict[str, Any]:
    """Return memory, processor time, threads and open files of this process."""
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
