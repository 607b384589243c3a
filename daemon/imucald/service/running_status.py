"""What `imucald status` shows of a running service, as the keys in docs/service.md."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from msgspec.structs import asdict

from imucald import __version__
from imucald.can.link.link import Link
from imucald.runtime.engine import Engine
from imucald.runtime.summary import RunCounts, summary
from imucald.service.calibration_store import CalibrationStore
from imucald.service.figures import NOT_SAVED, process_figures


class InputRates:
    """Samples a second of each channel, between two calls of `update`."""

    def __init__(self, now: float) -> None:
        self._rates: dict[str, float] = {}
        self._counted: dict[str, int] = {}
        self._at = now

    def update(self, counts: Mapping[str, int], now: float) -> None:
        """Take how many samples came so far, by channel."""
        span = max(now - self._at, 1e-9)
        self._rates = {c: (n - self._counted.get(c, 0)) / span for c, n in counts.items()}
        self._counted, self._at = dict(counts), now

    def of(self, channel: str) -> float:
        """[1/s]"""
        return self._rates.get(channel, 0.0)


def run_result(engine: Engine, link: Link) -> dict[str, Any]:
    """Summary of the run (see docs/json.md), with the link's counters."""
    counts = RunCounts(link.counters.received, engine.router.used, engine.router.rejected)
    found = summary(engine, counts, engine.timebase.now)
    found["link"] = dataclasses.asdict(link.counters)
    return found


def running_status(
    engine: Engine, link: Link, rates: InputRates, store: CalibrationStore | None
) -> dict[str, Any]:
    """The result so far, and how engine, bus, store and process are."""
    found = run_result(engine, link)
    for channel, row in found["signals"].items():
        row["rate_hz"] = round(rates.of(channel), 3)
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
