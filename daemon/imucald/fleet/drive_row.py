"""The result of one replay as rows of the tables."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucald.config import Config
from imucald.fleet.columns import AXES, PAIRS

EARLIEST = 946_684_800.0
"""1 January 2000 as UNIX time [s]: a logger that is before it has no clock."""
LATEST = 4_102_444_800.0
"""1 January 2100."""


def drive_row(
    result: Mapping[str, Any],
    covariance_deg2: NDArray[np.float64] | None,
    config: Config,
    start: float | None,
) -> dict[str, Any]:
    """The row of a drive without what names it: times as UNIX time [s].

    result: as `imucald replay --json` has it. covariance_deg2: (3, 3), rotation vector about the
    vehicle's axes. start: time stamp of the log's first frame [s].
    """
    mount, details = result["mount"], result["details"]
    known = start is not None and EARLIEST < start < LATEST
    quaternion = mount["quaternion_wxyz"] or (None,) * 4
    crown = math.degrees(config.vehicle.crown_std)
    row: dict[str, Any] = {
        "start": start if known else None,
        "end": start + result["duration_s"] if known and start is not None else None,
        "duration_s": result["duration_s"],
        "distance_m": details.get("distance"),
        "state": result["state"],
        "first_usable_s": result["first_usable_s"],
        "first_fine_s": result["first_fine_s"],
        **dict(zip(("q_w", "q_x", "q_y", "q_z"), quaternion, strict=True)),
        **{f"{angle}_deg": mount[f"{angle}_deg"] for angle in ("roll", "pitch", "yaw")},
        "crown_std_deg": crown,
        "driving_side": config.vehicle.driving_side,
        **{f"waiting_{a}": result["waiting_for"].get(a) for a in ("roll", "pitch", "yaw")},
        "causes": json.dumps(sorted(set(_causes(result)))),
        "frames_read": result["frames"]["read"],
        "frames_used": result["frames"]["used"],
        "rejected": json.dumps(result["frames"]["rejected"], sort_keys=True),
        "rate_accel_hz": result["signals"].get("accel", {}).get("rate_hz"),
    }
    if covariance_deg2 is not None and np.isfinite(covariance_deg2).all():
        row["crown_std_deg"] = min(crown, math.sqrt(max(float(covariance_deg2[0, 0]), 0.0)))
        for pair in PAIRS:
            i, j = (AXES.index(axis) for axis in pair)
            row[f"cov_{pair}_deg2"] = round(float(covariance_deg2[i, j]), 9)
    return row


REJECTED_SHARE = 0.001
"""A share of frames that are rejected for one reason from which it counts as a cause: a sound bus
has none, and one burst at the start of a log is below."""


def _causes(result: Mapping[str, Any]) -> Iterator[str]:
    """Faults of the drive by name: sensors, contradictions, a mount that moved, bad frames."""
    for event in result["signal_health"]["events"]:
        yield f"{event['sensor']} {event['fault']}"
    for fault in result["details"].get("faults", ()):
        yield f"contradiction: {fault['fault']}"
    if result["details"].get("shifts"):
        yield "mount moved in the drive"
    if result["details"].get("creep"):
        yield "mount creeps"
    least = REJECTED_SHARE * max(result["frames"]["used"], 1)
    for reason, count in result["frames"]["rejected"].items():
        if count > least:
            yield f"frames: {reason}"


def day_of(start: float | None) -> str | None:
    """The day (ISO, UTC) of a UNIX time [s]."""
    return None if start is None else datetime.fromtimestamp(start, UTC).date().isoformat()


def event_rows(result: Mapping[str, Any], start: float | None) -> list[dict[str, Any]]:
    """The rows of `events` of a drive, without what names it, in order of time."""
    zero = start if start is not None and EARLIEST < start < LATEST else None
    rows = [*_shifts(result["details"]), *_sensor_faults(result["signal_health"]["events"])]
    for fault in result["details"].get("faults", ()):
        rows.append({"t_s": fault["t"], "kind": "fault", "name": fault["fault"], "axes": ""})
    for row in rows:
        row["time"] = None if zero is None else zero + row["t_s"]
    return sorted(rows, key=lambda row: (row["t_s"], row["kind"], row["name"], row["axes"]))


def _shifts(details: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    for shift in details.get("shifts", ()):
        axis = AXES[("roll", "pitch", "yaw").index(shift["angle"])]
        yield {
            "t_s": shift["t"],
            "kind": "shift",
            "name": shift["angle"],
            "axes": axis,
            f"d_{axis}_deg": shift["size_deg"],
        }


def _sensor_faults(events: Sequence[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    for event in events:
        yield {
            "t_s": event["since_s"],
            "until_s": event["until_s"],
            "kind": "sensor",
            "name": f"{event['sensor']} {event['fault']}",
            "axes": "".join(event["axes"]),
        }
