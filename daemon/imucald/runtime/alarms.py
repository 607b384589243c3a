"""The alarms of the health frame in words, and which of them mean that nothing good is sent."""

from __future__ import annotations

from collections.abc import Mapping

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
    "frames_lost": "frames lost",
    "id_conflict": "another node sends our ids",
    "send_failed": "frames not sent",
}
"""By the names of `Health`."""

PASSING = frozenset({"input_rejected", "frames_lost"})
"""Alarms that a good bus raises now and then: reported, but no fault."""


def alarms_of(health: Mapping[str, object]) -> dict[str, str]:
    """The alarms that are on, by name, in words."""
    return {name: words for name, words in ALARMS.items() if health.get(name)}
