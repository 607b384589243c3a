"""Analyse all drives together: the rows of the tables under `analysis/`."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from imucald.core.angles import DEG_PER_RAD, RAD_PER_DEG
from imucald.core.arrays import Array
from imucald.fleet.analysis.causes import UNKNOWN, cause_rows, never_usable_rows
from imucald.fleet.analysis.components import VarianceComponent
from imucald.fleet.analysis.known_drives import KnownDrives, known_drives
from imucald.fleet.analysis.mounts import (
    Segments,
    Shrunk,
    first_units,
    segment_mounts,
    shrink,
    type_half_width,
)
from imucald.fleet.analysis.population import Population, population
from imucald.fleet.analysis.remounts import Remounts, find_remounts
from imucald.mount.angle_deviations import angle_deviations
from imucald.mount.estimate import ANGLES
from imucald.mount.mount_words import SD_95

Columns = Mapping[str, Sequence[Any]]
Rows = list[dict[str, Any]]

GROUPS = ("sensor_batch", "firmware")
"""Columns by which vehicles of a type are compared."""
OF_VEHICLE = ("vehicle_type", "sensor_serial", "sensor_batch", "firmware")


def analysed(
    columns: Columns, groups: Sequence[str] = GROUPS, shifts: Sequence[Mapping[str, Any]] = ()
) -> dict[str, Rows]:
    """Analyse all drives together. columns: columns of `drives`, sorted by vehicle and time.

    shifts: rows of `events` with the kind "shift": moves of the sensor that were found within a
    drive. Returns the rows of each table in `analysis_columns`. Times have the same form as in
    `columns`.
    """
    found: dict[str, Rows] = {
        "analysis/causes": cause_rows(columns),
        "analysis/never_usable": never_usable_rows(columns),
    }
    drives = known_drives(columns, {row["log_key"] for row in shifts})
    within = _within_rows(columns, shifts)
    names = ("types", "vehicles", "segments", "remounts", "groups", "outliers")
    if not len(drives):
        return found | {f"analysis/{name}": [] for name in names} | {"analysis/remounts": within}
    remounts = find_remounts(drives)
    segments = segment_mounts(drives, remounts)
    first = drives.row[segments.first[segments.starts]]
    by = {name: [columns[name][i] for i in first] for name in groups}
    people = population(first_units(drives, segments), by)
    shrunk = shrink(drives, segments, people)
    vehicles = _vehicle_rows(columns, drives, segments, people, shrunk)
    return found | {
        "analysis/types": _type_rows(drives, segments, remounts, people),
        "analysis/vehicles": vehicles,
        "analysis/segments": _segment_rows(columns, drives, segments),
        "analysis/remounts": [*_remount_rows(columns, drives, remounts), *within],
        "analysis/groups": _group_rows(people),
        "analysis/outliers": [
            row | {"size_deg": math.hypot(*(row[f"d_{a}_deg"] for a in "xyz"))}
            for row in vehicles
            if row["outlier"]
        ],
    }


def _xyz(form: str, values: Sequence[float] | Array) -> dict[str, float | None]:
    return {form.format(a): _number(v) for a, v in zip("xyz", values, strict=True)}


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _mounts(rotation: Rotation, half_width: Array, prefix: str = "") -> Rows:
    """Return rows with quaternion (w not negative), angles and 95 % intervals of each mount."""
    quaternions = rotation.as_quat(canonical=True)
    angles = rotation.as_euler("ZYX", degrees=True)
    return [
        {
            **{f"{prefix}q_{n}": float(q[i]) for n, i in (("w", 3), ("x", 0), ("y", 1), ("z", 2))},
            f"{prefix}roll_deg": float(a[2]),
            f"{prefix}pitch_deg": float(a[1]),
            f"{prefix}yaw_deg": float(a[0]),
            **_xyz(f"{prefix}ci95_{{}}_deg", h),
            **_of_angles(f"{prefix}ci95_{{}}_deg", R, h),
        }
        for q, a, R, h in zip(quaternions, angles, rotation.as_matrix(), half_width, strict=True)
    ]


def _of_angles(form: str, R_vehicle_from_sensor: Array, half_width: Array) -> dict[str, Any]:
    """Convert the half widths (3,) of the 95 % intervals about x, y, z to half widths for roll,
    pitch and yaw [deg]."""
    if not np.isfinite(half_width).all():
        return dict.fromkeys(map(form.format, ANGLES))
    covariance = np.diag((half_width * RAD_PER_DEG / SD_95) ** 2).tolist()
    found = angle_deviations(R_vehicle_from_sensor, covariance)
    halves = (_number(SD_95 * std * DEG_PER_RAD) for std in found)
    return dict(zip(map(form.format, ANGLES), halves, strict=True))


def _spread(form: str, parts: Sequence[VarianceComponent]) -> dict[str, float | None]:
    return {
        **_xyz(form.format("{}"), [math.sqrt(c.value) for c in parts]),
        **_xyz(form.format("low_{}"), [math.sqrt(c.low) for c in parts]),
        **_xyz(form.format("high_{}"), [math.sqrt(c.high) for c in parts]),
    }


def _type_rows(
    drives: KnownDrives, segments: Segments, remounts: Remounts, people: Population
) -> Rows:
    crown = np.array(
        [segments.crown[segments.starts][drives.kind == k].mean() for k in range(len(drives.kinds))]
    )
    mounts = _mounts(people.centre, type_half_width(people, crown))
    of_drive = drives.kind[drives.vehicle]
    return [
        {
            "vehicle_type": name,
            "vehicles": int((drives.kind == k).sum()),
            "drives": int((of_drive == k).sum()),
            **mounts[k],
            **_spread("tau_{}_deg", people.T[k]),
            **_spread("drive_{}_deg", remounts.components[k]),
            "crown_std_deg": float(crown[k]),
        }
        for k, name in enumerate(drives.kinds)
    ]


def _vehicle_rows(
    columns: Columns, drives: KnownDrives, segments: Segments, people: Population, shrunk: Shrunk
) -> Rows:
    s = segments.ends
    raw = _mounts(segments.rotation[s], segments.half_width()[s])
    better = _mounts(shrunk.rotation, shrunk.half_width, "shrunk_")
    known = np.bincount(drives.vehicle, minlength=len(drives.vehicles))
    all_drives = Counter(str(v) for v in columns["vehicle"])
    count = np.bincount(segments.vehicle)
    last = drives.row[segments.last[s]]
    unordered = np.bincount(drives.vehicle[~drives.is_after], minlength=len(drives.vehicles))
    return [
        {
            "vehicle": name,
            **{column: columns[column][last[i]] for column in OF_VEHICLE},
            "vehicle_type": columns["vehicle_type"][last[i]] or UNKNOWN,
            "drives": int(known[i]),
            "drives_unknown": all_drives[name] - int(known[i]),
            "segments": int(count[i]),
            **raw[i],
            **better[i],
            **_xyz("weight_{}", shrunk.weight[i]),
            **_xyz("d_{}_deg", people.e[i]),
            "p": float(people.p[i]),
            "q": float(people.q[i]),
            "outlier": bool(people.outlier[i]),
            "drives_unordered": int(unordered[i]),
        }
        for i, name in enumerate(drives.vehicles)
    ]


def _segment_rows(columns: Columns, drives: KnownDrives, segments: Segments) -> Rows:
    mounts = _mounts(segments.rotation, segments.half_width())
    number = np.arange(len(segments.vehicle)) - np.repeat(
        segments.starts, np.diff(segments.starts, append=len(segments.vehicle))
    )
    rows = []
    for i, mount in enumerate(mounts):
        first, last = (int(drives.row[x[i]]) for x in (segments.first, segments.last))
        rows.append({
            "vehicle": drives.vehicles[segments.vehicle[i]],
            "segment": int(number[i]),
            "start": columns["start"][first],
            "end": columns["end"][last],
            "first_log_key": columns["log_key"][first],
            "last_log_key": columns["log_key"][last],
            "last_state": columns["state"][last],
            "drives": int(segments.last[i] - segments.first[i] + 1),
            **mount,
        })  # fmt: skip
    return rows


def _remount_rows(columns: Columns, drives: KnownDrives, remounts: Remounts) -> Rows:
    rows = []
    for i, drive in enumerate(remounts.drive):
        after, before = (int(drives.row[k]) for k in (drive, drive - 1))
        rows.append({
            "vehicle": drives.vehicles[drives.vehicle[drive]],
            "before_log_key": columns["log_key"][before],
            "after_log_key": columns["log_key"][after],
            "before": columns["end"][before],
            "after": columns["start"][after],
            **_xyz("d_{}_deg", remounts.turn[i]),
            "size_deg": float(np.linalg.norm(remounts.turn[i])),
            "p": float(remounts.p[i]),
            "q": float(remounts.q[i]),
            "found": bool(remounts.found[i]),
        })  # fmt: skip
    return rows


def _within_rows(columns: Columns, shifts: Sequence[Mapping[str, Any]]) -> Rows:
    """Return rows for the moves that were found within drives. The time of a move is between the
    start of the drive and the detection."""
    row_of = {key: i for i, key in enumerate(columns["log_key"])}
    rows = []
    for shift in shifts:
        turn = [shift[f"d_{axis}_deg"] for axis in "xyz"]
        known = None not in turn
        rows.append({
            "vehicle": shift["vehicle"],
            "before_log_key": shift["log_key"],
            "after_log_key": shift["log_key"],
            "before": columns["start"][row_of[shift["log_key"]]],
            "after": shift["time"],
            **{f"d_{axis}_deg": v for axis, v in zip("xyz", turn, strict=True)},
            "size_deg": math.hypot(*turn) if known else None,
            "found": True,
            "found_s": shift["t_s"],
        })  # fmt: skip
    return rows


def _group_rows(people: Population) -> Rows:
    return [
        {
            "column": g.column,
            "name": g.name,
            "vehicles": g.vehicles,
            "types": g.kinds,
            **_xyz("d_{}_deg", g.effect),
            **_xyz("ci95_{}_deg", g.half_width),
            "p": _number(g.p),
            "q": _number(g.q),
            "verdict": "too few" if math.isnan(g.p) else "bad" if g.found else "ok",
        }
        for g in people.groups
    ]
