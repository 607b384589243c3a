"""The part of the daemon's status that a feed sends, as plain data."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from imucald.mount.mount_words import SD_95
from imucald.runtime.flow import present_alarms

QUALITIES = ("not_available", "restored", "usable", "fine", "suspect")


def status_content(at: float, status: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return state, mount with ± (95 %), and missing evidence. `running` is false if no daemon
    answers.

    at: wall clock [s]. status: see `daemon_source.Reading`.
    """
    if status is None:
        return {"at": round(at, 3), "running": False}
    mount = status["mount"]
    return {
        "at": round(at, 3),
        "running": True,
        "state": status["state"],
        "quality": QUALITIES[status["quality"]],
        "held": bool(status.get("held")),
        "mount": {
            **{f"{a}_deg": mount[f"{a}_deg"] for a in ("roll", "pitch", "yaw")},
            "plus_minus_deg": _halves({axis: mount["std_deg"][axis] for axis in "xyz"}),
            "angle_plus_minus_deg": _halves(mount.get("angle_std_deg", {})),
            "quaternion_wxyz": mount["quaternion_wxyz"],
            "sits": mount["sits"],
        },
        "waiting_for": status["waiting_for"],
        "alarms": list(present_alarms(status)),
        "bus": status["link"]["state"],
    }


def _halves(std: Mapping[str, float | None]) -> dict[str, float | None]:
    return {name: None if s is None else SD_95 * s for name, s in std.items()}
