"""Convert the result of one replay to rows of the tables."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from typing import Any

import numpy as np

from imucald.api.columns import Columns
from imucald.api.drive import DriveResult
from imucald.config import Config
from imucald.fleet.columns import AXES, PAIRS, QUATERNION
from imucald.fleet.fleet_file import Fleet
from imucald.fleet.task import Task
from imucald.mount.mount_words import is_move

EARLIEST = 946_684_800.0
"""1 January 2000 as UNIX time [s]. A logger with earlier time stamps counts as a logger without a
clock."""
LATEST = 4_102_444_800.0
"""1 January 2100 as UNIX time [s]. A logger with later time stamps counts as a logger without a
clock."""


def drive_row(drive: DriveResult, config: Config) -> dict[str, Any]:
    """Return the row of a drive without its names (vehicle, day, source). Times are UNIX times
    [s]."""
    result = drive.to_dict()
    mount = result["mount"]
    start, end = known_times(drive)
    quaternion = mount["quaternion_wxyz"] or (None,) * 4
    crown = math.degrees(config.vehicle.crown_std)
    row: dict[str, Any] = {
        "start": start,
        "end": end,
        "duration_s": drive.duration_s,
        "distance_m": result["details"].get("distance"),
        "state": drive.state,
        "first_usable_s": drive.first_usable_s,
        "first_fine_s": drive.first_fine_s,
        **dict(zip(QUATERNION, quaternion, strict=True)),
        **{f"{angle}_deg": mount[f"{angle}_deg"] for angle in ("roll", "pitch", "yaw")},
        "crown_std_deg": crown,
        "driving_side": config.vehicle.driving_side,
        **{f"waiting_{a}": drive.waiting_for.get(a) for a in ("roll", "pitch", "yaw")},
        "causes": json.dumps(sorted(set(_causes(result)))),
        "frames_read": drive.frames["read"],
        "frames_used": drive.frames["used"],
        "rejected": json.dumps(drive.frames["rejected"], sort_keys=True),
        "rate_accel_hz": result["signals"].get("accel", {}).get("rate_hz"),
    }
    if drive.mount is not None and np.isfinite(drive.mount.covariance_deg2).all():
        covariance = drive.mount.covariance_deg2
        row["crown_std_deg"] = min(crown, math.sqrt(max(float(covariance[0, 0]), 0.0)))
        for pair in PAIRS:
            i, j = (AXES.index(axis) for axis in pair)
            row[f"cov_{pair}_deg2"] = round(float(covariance[i, j]), 9)
    return row


def drive_values(
    fleet: Fleet, task: Task, log_key: str | None, drive: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the row of a drive with its names. The names follow from the rules of the fleet for
    the day of the drive."""
    day = day_of(drive["start"]) or task.date
    facts = fleet.facts(task.vehicle, day)
    return {
        **drive,
        "log_key": log_key,
        "vehicle": task.vehicle,
        "vehicle_type": fleet.named(task.source)[2] or facts.get("type"),
        **{name: facts.get(name) for name in ("sensor_serial", "sensor_batch", "firmware")},
        "sources": json.dumps([task.source], ensure_ascii=False),
        "date": day,
    }


def known_times(drive: DriveResult) -> tuple[float | None, float | None]:
    """Return the times of the first and the last used frame as UNIX time [s]; None for a logger
    without a clock."""
    if drive.start_us is None or drive.end_us is None:
        return None, None
    start, end = drive.start_us / 1e6, drive.end_us / 1e6
    return (start, end) if EARLIEST < start < LATEST else (None, None)


REJECTED_SHARE = 0.001
"""A reason for rejected frames counts as a cause if at least this share of frames was rejected. On
a healthy bus, no frames are rejected; a single burst at the start of a log gives a smaller share.
"""


def _causes(result: Mapping[str, Any]) -> Iterator[str]:
    """Yield the names of the faults in a drive: faulty sensors, contradictions between signals, a
    moved sensor, rejected frames."""
    for event in result["signal_health"]["events"]:
        yield f"{event['sensor']} {event['fault']}"
    for fault in result["details"].get("faults", ()):
        yield f"contradiction: {fault['fault']}"
    if any(map(is_move, result["details"].get("shifts", ()))):
        yield "mount moved in the drive"
    if result["details"].get("creep"):
        yield "mount creeps"
    least = REJECTED_SHARE * max(result["frames"]["used"], 1)
    for reason, count in result["frames"]["rejected"].items():
        if count > least:
            yield f"frames: {reason}"


def day_of(start: float | None) -> str | None:
    """Return the day (ISO, UTC) of a UNIX time [s]."""
    return None if start is None else datetime.fromtimestamp(start, UTC).date().isoformat()


def event_rows(events: Columns, has_clock: bool) -> list[dict[str, Any]]:
    """Return the rows of `events` of a drive, without the names of the drive. NaN becomes null."""
    names = [column.name for column in events.columns]
    rows = []
    for values in zip(*(array.tolist() for array in events.arrays), strict=True):
        row: dict[str, Any] = dict(zip(names, values, strict=True))
        row = {name: None if value != value else value for name, value in row.items()}  # noqa: PLR0124
        row["time"] = row["time"] / 1e6 if has_clock else None
        rows.append(row)
    return rows
