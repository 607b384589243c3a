"""Text and kind of the first line of a daemon's status: do corrected frames flow now?

The module gives the alarms of the health frame in words, and those that mean that no good data are
sent.
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
"""Texts by the names of `Health`."""

PASSING = frozenset({"input_rejected", "frames_lost"})
"""Alarms that a good bus raises now and then: they are reported, but are no fault."""


STARTING_S = 2.0
"""Time from its start in which a daemon without input counts as starting [s].

An input is missing after one second, and one sample a second (GNSS speed) is the slowest input.
"""


def is_starting(status: Mapping[str, Any]) -> bool:
    """Return whether the first samples of a daemon may still come. status: its status."""
    return not status["signals"] and status["uptime_s"] < STARTING_S


def present_alarms(status: Mapping[str, Any]) -> dict[str, str]:
    """Return the alarms in a daemon's status; a missing input is no alarm while it is starting."""
    found = alarms_of(status["health"])
    if not is_starting(status):
        return found
    return {name: words for name, words in found.items() if not name.endswith("_missing")}


def alarms_of(health: Mapping[str, object]) -> dict[str, str]:
    """Return the active alarms by name, in words."""
    return {name: words for name, words in ALARMS.items() if health.get(name)}


GOOD = {1: "restored", 2: "usable", 3: "fine"}
"""Qualities of a corrected frame that a receiver may use, in rising order."""
SUSPECT = 4


class FlowKind(StrEnum):
    """Kind of data that a receiver on the bus gets now."""

    GOOD = "good"
    STARTING = "starting"
    NOT_YET = "not yet"
    """Frames without numbers, because the mount is not known."""
    SUSPECT = "suspect"
    FAULTY = "faulty"
    """Frames without numbers, because the accelerometer is faulty."""
    CONFLICT = "conflict"
    """Our frames, and another node's under the same identifiers."""
    NONE = "none"


class Flow(Struct, frozen=True):
    """kind: what a receiver gets now; text: the same in a sentence, with the cause."""

    kind: FlowKind
    text: str


def flow(status: Mapping[str, Any]) -> Flow:
    """Return what a receiver gets now, from a daemon's status (docs/service.md)."""
    state, quality = status["state"], status["quality"]
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
    if quality == SUSPECT:
        return Flow(
            FlowKind.SUSPECT,
            f"SUSPECT: corrected frames are sent and marked suspect (mount: {state})",
        )
    if quality in GOOD:
        return Flow(FlowKind.GOOD, f"corrected frames flow, marked {GOOD[quality]}")
    text = f"not yet: corrected frames say 'not available' (mount: {state})"
    return Flow(FlowKind.NOT_YET, text)


def _why_none(status: Mapping[str, Any]) -> str | None:
    """Return why no corrected data are sent now; None: they are sent, or will be."""
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
