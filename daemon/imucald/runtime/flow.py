"""Whether corrected frames flow now: the first line of what a daemon says of itself."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Any

from msgspec import Struct

from imucald.core.text import duration
from imucald.motion.ticks import TICK_S
from imucald.runtime.alarms import is_starting, present_alarms
from imucald.runtime.input_health import MISSING_TICKS

GOOD = {1: "restored", 2: "usable", 3: "fine"}
"""Qualities of a corrected frame that a receiver may use, from the least to the best."""
SUSPECT = 4


class FlowKind(StrEnum):
    """What a receiver on the bus gets now."""

    GOOD = "good"
    STARTING = "starting"
    NOT_YET = "not yet"
    """Frames without numbers, as the mount is not known."""
    SUSPECT = "suspect"
    FAULTY = "faulty"
    """Frames without numbers, as the accelerometer is faulty."""
    NONE = "none"


TROUBLE = frozenset({FlowKind.SUSPECT, FlowKind.FAULTY, FlowKind.NONE})
"""Somebody has to do something."""


class Flow(Struct, frozen=True):
    """kind: what a receiver gets now; text: the same in a sentence, with the cause."""

    kind: FlowKind
    text: str


def flow(status: Mapping[str, Any]) -> Flow:
    """What a receiver gets now, of a daemon's status (docs/service.md)."""
    state, quality = status["state"], status["quality"]
    if (cause := _why_none(status)) is not None:
        return Flow(FlowKind.NONE, f"{cause}: no corrected frames (mount: {state})")
    if is_starting(status):
        return Flow(FlowKind.STARTING, "starting: no corrected frames yet")
    if "accelerometer_faulty" in present_alarms(status):
        text = "ACCELEROMETER FAULTY: corrected frames say 'not available'"
        return Flow(FlowKind.FAULTY, f"{text} (mount: {state})")
    if quality == SUSPECT:
        return Flow(FlowKind.SUSPECT, f"SUSPECT: corrected frames flow and say so (mount: {state})")
    if quality in GOOD:
        return Flow(FlowKind.GOOD, f"corrected frames flow, marked {GOOD[quality]}")
    text = f"not yet: corrected frames say 'not available' (mount: {state})"
    return Flow(FlowKind.NOT_YET, text)


def _why_none(status: Mapping[str, Any]) -> str | None:
    """Why nothing corrected is sent now; None: it is sent, or will be."""
    alarms = present_alarms(status)
    if status["link"]["state"] != "up":
        return f"BUS {status['link']['state'].upper()}"
    if "send_failed" in alarms:
        return "FRAMES NOT SENT"
    if "accelerometer_missing" not in alarms:
        return None
    silent = float(status.get("silent_s", 0.0))  # an older daemon does not say it
    if silent >= MISSING_TICKS * TICK_S:
        return f"NO INPUT for {duration(silent)}"
    return "NO ACCELEROMETER"
