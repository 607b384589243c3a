"""The first line of a daemon's status: it states whether corrected frames are sent now.

The module also converts the alarms of the health frame to texts.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Any

from msgspec import Struct

from imucald.core.text import duration
from imucald.motion.ticks import TICK_S
from imucald.runtime.input_health import MISSING_TICKS

ALARMS = {
    "accelerometer_missing": "no accelerometer",
    "gyroscope_missing": "no gyroscope",
    "speed_missing": "no speed",
    "accelerometer_faulty": "accelerometer faulty",
    "gyroscope_faulty": "gyroscope faulty",
    "magnetometer_faulty": "magnetometer faulty",
    "speed_faulty": "speed faulty",
    "yaw_rate_faulty": "yaw rate faulty",
    "input_rejected": "inputs rejected",
    "frames_lost": "frames lost or late",
    "id_conflict": "another node sends our ids",
    "send_failed": "frames not sent",
}
"""Texts of the alarms, by the names in `Health`."""

PASSING = frozenset({"input_rejected", "frames_lost"})
"""Alarms that also occur on a good bus. These alarms are reported, but do not count as a fault."""


STARTING_S = 2.0
"""During this time after its start, a daemon without input counts as starting [s]. An input counts
as missing after one second, and the slowest input (GNSS speed) has one sample per second.
"""


def is_starting(status: Mapping[str, Any]) -> bool:
    """Return whether a daemon has just started and its first samples may still arrive. status:
    status of the daemon."""
    return not status["signals"] and status["uptime_s"] < STARTING_S


def present_alarms(status: Mapping[str, Any]) -> dict[str, str]:
    """Return the alarms in a daemon's status. While the daemon is starting, a missing input is not
    an alarm."""
    found = alarms_of(status["health"])
    if not is_starting(status):
        return found
    return {name: words for name, words in found.items() if not name.endswith("_missing")}


def alarms_of(health: Mapping[str, object]) -> dict[str, str]:
    """Return the active alarms by name, in words."""
    return {name: words for name, words in ALARMS.items() if health.get(name)}


QUALITIES = ("not_available", "restored", "usable", "fine", "suspect")
"""Names of the qualities of corrected frames, by number."""


class FlowKind(StrEnum):
    """What a receiver on the bus gets now, as `flow` of `imucald status --json` names it."""

    SERVED = "good"
    """Corrected frames that are marked *restored*, *usable* or *fine*. Here alone "good" includes
    *restored*."""
    STARTING = "starting"
    """No frames yet: the daemon started a moment ago."""
    NOT_YET = "not yet"
    """Frames *not available*, because the mount is not known."""
    SUSPECT = "suspect"
    """Corrected frames that are marked *suspect*."""
    FAULTY = "faulty"
    """Frames *not available*, because the accelerometer is faulty."""
    CONFLICT = "conflict"
    """Corrected frames, and frames of another node with the same identifiers."""
    NONE = "none"
    """No corrected frames: the bus is down, the accelerometer is silent, or sending failed."""


class Flow(Struct, frozen=True):
    """What a receiver on the bus gets now. text: the first line of `imucald status`, with the
    cause."""

    kind: FlowKind
    text: str


def flow(status: Mapping[str, Any]) -> Flow:
    """Return what a receiver on the bus gets now. status: status of a daemon (docs/service.md)."""
    state, quality = status["state"], QUALITIES[status["quality"]]
    if (cause := _why_none(status)) is not None:
        return Flow(FlowKind.NONE, f"{cause}: no corrected frames (mount: {state})")
    if "id_conflict" in present_alarms(status):
        text = f"ANOTHER NODE SENDS OUR IDS: its frames look like ours (mount: {state})"
        return Flow(FlowKind.CONFLICT, text)
    if is_starting(status):
        return Flow(FlowKind.STARTING, "starting: no corrected frames yet")
    if "accelerometer_faulty" in present_alarms(status):
        text = "ACCELEROMETER FAULTY: corrected frames say 'not available'"
        return Flow(FlowKind.FAULTY, f"{text} (mount: {state})")
    if quality == "suspect":
        text = f"SUSPECT: corrected frames are sent and marked suspect (mount: {state})"
        return Flow(FlowKind.SUSPECT, text)
    if quality != "not_available":
        return Flow(FlowKind.SERVED, f"corrected frames flow, marked {quality}")
    when = "not yet" if status.get("first_usable_s") is None else "not certain any more"
    return Flow(FlowKind.NOT_YET, f"{when}: corrected frames say 'not available' (mount: {state})")


def _why_none(status: Mapping[str, Any]) -> str | None:
    """Return the reason why no corrected frames are sent now. None if frames are sent or the daemon
    is starting."""
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
