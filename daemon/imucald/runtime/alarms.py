"""The alarms of the health frame in words, and which of them mean that nothing good is sent."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

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
"""By the names of `Health`."""

PASSING = frozenset({"input_rejected", "frames_lost"})
"""Alarms that a good bus raises now and then: reported, but no fault."""


STARTING_S = 2.0
"""Within this time from its start a daemon that has heard nothing is starting [s]: an input is
missing after one second, and a sample a second (GNSS speed) is the rarest that there is."""


def is_starting(status: Mapping[str, Any]) -> bool:
    """Whether a daemon's first samples may be on their way; status: as it states it."""
    return not status["signals"] and status["uptime_s"] < STARTING_S


def present_alarms(status: Mapping[str, Any]) -> dict[str, str]:
    """The alarms of a daemon's status: a missing input is none while it is starting."""
    found = alarms_of(status["health"])
    if not is_starting(status):
        return found
    return {name: words for name, words in found.items() if not name.endswith("_missing")}


def alarms_of(health: Mapping[str, object]) -> dict[str, str]:
    """The alarms that are on, by name, in words."""
    return {name: words for name, words in ALARMS.items() if health.get(name)}
