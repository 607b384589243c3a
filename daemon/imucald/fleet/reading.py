"""Analyse the folder of a fleet: read the table `drives`, and write the tables under `analysis/`.
The texts about these tables stand here too."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from imucald.api.recorder import SHIFT
from imucald.core.errors import ImucaldError
from imucald.core.text import clock, counted
from imucald.fleet.analysis.analyse import GROUPS, analysed
from imucald.fleet.analysis.causes import UNKNOWN
from imucald.fleet.analysis.remounts import LEAST_PAIRS
from imucald.fleet.analysis_columns import ANALYSIS
from imucald.fleet.columns import COVARIANCES, QUATERNION, TABLES
from imucald.fleet.compaction import read_tables
from imucald.fleet.store import Store
from imucald.fleet.tables import as_parquet, main_file, read_file, table_of
from imucald.mount.estimate import ANGLES
from imucald.mount.mount_words import UNKNOWN_HALF_DEG

NEEDED = (
    *("log_key", "vehicle", "vehicle_type", "sensor_serial", "sensor_batch", "firmware"),
    *("start", "end", "date", "state", "first_usable_s", *QUATERNION, *COVARIANCES),
    *("crown_std_deg", "driving_side", "waiting_roll", "waiting_pitch", "waiting_yaw", "causes"),
    "diagnosed",
)
"""Columns of `drives` that the analysis reads."""


def analyse_fleet(store: Store, groups: Sequence[str] = GROUPS) -> dict[str, pa.Table]:
    """Write all tables of the analysis again, and return them. Raises ImucaldError."""
    wrong = [g for g in groups if g not in {c.name for c in TABLES["drives"] if c.kind == "text"}]
    if wrong:
        raise ImucaldError(f"--group {wrong[0]}: the drives table has no text column of this name")
    tables_read = read_tables(store, ("drives", "events"))
    drives, events = tables_read["drives"], tables_read["events"]
    of_shift = ("log_key", "vehicle", "time", "t_s", "d_x_deg", "d_y_deg", "d_z_deg")
    moved = plain_columns(events.filter(pc.equal(events.column("kind"), SHIFT)), of_shift)
    shifts = [dict(zip(moved, row, strict=True)) for row in zip(*moved.values(), strict=True)]
    rows = analysed(plain_columns(drives, (*NEEDED, *groups)), groups, shifts)
    tables = {name: table_of(name, rows[name], ANALYSIS[name]) for name in ANALYSIS}
    for name, table in tables.items():
        store.write(main_file(name), as_parquet(table))
    return tables


def mixed_words(drives: pa.Table) -> str:
    """Return a text about types whose drives were evaluated with different configurations or
    versions of imucald; "" if there are none.

    drives: the table `drives`. All drives of a type have the same configuration in one run, so an
    earlier run evaluated some of these drives.
    """
    counts: dict[str, Counter[str]] = {}
    for row in drives.select(["vehicle_type", "run_key"]).to_pylist():
        counts.setdefault(row["vehicle_type"] or UNKNOWN, Counter())[row["run_key"]] += 1
    mixed = [
        f"{kind} ({' and '.join(str(n) for _, n in keys.most_common())} drives)"
        for kind, keys in sorted(counts.items())
        if len(keys) > 1
    ]
    if not mixed:
        return ""
    return (
        f"several configurations or versions evaluated the drives of one type: {', '.join(mixed)}; "
        "'imucald fleet run --redo config' evaluates the older ones again"
    )


def plain_columns(table: pa.Table, names: Sequence[str]) -> dict[str, list[Any]]:
    """Convert columns to lists, with times as UNIX time [s]."""
    found = {}
    for name in names:
        column = table.column(name)
        if pa.types.is_timestamp(column.type):
            column = pc.divide(column.cast(pa.int64()).cast(pa.float64()), 1e6)
        found[name] = column.to_pylist()
    return found


def read_analysis(store: Store) -> dict[str, pa.Table]:
    """Return the tables of the last analysis. Raises ImucaldError if there is no analysis."""
    if not store.exists(main_file("analysis/vehicles")):
        raise ImucaldError(
            f"{store.url}: there is no analysis yet; run 'imucald fleet analyse' first"
        )
    return {name: read_file(store, main_file(name), ANALYSIS[name]) for name in ANALYSIS}


def has_common_mount(row: Mapping[str, Any]) -> bool:
    """True if the sensors in all vehicles of a type have the same mount by design. row: row of
    `analysis/types`.

    False if an angle of the type's mount is unknown although there are several vehicles. In this
    case the mounts differ by design, so the spread between vehicles and the difference from the
    type have no meaning.
    """
    halves = [row[f"ci95_{axis}_deg"] for axis in "xyz"]
    return row["vehicles"] < 2 or all(h is not None and h < UNKNOWN_HALF_DEG for h in halves)


def shown_types(types: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return rows of `analysis/types`. The intervals of types without a common mount are
    removed."""
    no_interval = {f"ci95_{angle}_deg": None for angle in ANGLES}
    return [{**row, **({} if has_common_mount(row) else no_interval)} for row in types]


def spread_text(row: Mapping[str, Any]) -> str:
    """Return the spread between the vehicles of a type about x, y, z [deg] as text; "-" if there is
    none. row: row of `analysis/types`.
    """
    if row["vehicles"] < 2 or not has_common_mount(row):
        return "-"
    return ", ".join(f"{row[f'tau_{axis}_deg']:.2f}" for axis in "xyz")


def no_common_mount_words(types: Iterable[Mapping[str, Any]]) -> str:
    """Return a text about the types whose vehicles have no common mount; "" if all types have a
    common mount.

    types: rows of `analysis/types`.
    """
    names = ", ".join(row["vehicle_type"] for row in types if not has_common_mount(row))
    if not names:
        return ""
    return (
        f"no common mount for {names}: the vehicles' mounts differ too much. If they differ by "
        "design, give each design its own type (column 'type' of the list of vehicles)"
    )


def present_mounts(
    vehicles: Sequence[Mapping[str, Any]],
    segments: Sequence[Mapping[str, Any]],
    remounts: Sequence[Mapping[str, Any]],
) -> list[dict[str, Any]]:
    """Return the mount of each vehicle since the last move of its sensor: the last row of the
    vehicle in `segments`.

    The columns vehicle_type, all_drives and moves (number of found moves) are added. The rows are
    sorted by vehicle.
    """
    moves = Counter(row["vehicle"] for row in remounts if row["found"])
    last: dict[str, Mapping[str, Any]] = {}
    for row in sorted(segments, key=lambda r: r["segment"]):
        last[row["vehicle"]] = row
    return [
        {
            **last[v["vehicle"]],
            "vehicle_type": v["vehicle_type"],
            "all_drives": v["drives"],
            "moves": moves[v["vehicle"]],
        }
        for v in sorted(vehicles, key=lambda v: v["vehicle"])
        if v["vehicle"] in last
    ]


def names_of(rows: Iterable[Mapping[str, Any]]) -> str:
    """Return the names of the vehicles in rows, each once, in order: "car-1, car-3"."""
    names = list(dict.fromkeys(str(row["vehicle"]) for row in rows))
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" * (len(names) > 5))


def time_text(time: datetime | None, key: str) -> str:
    """Return a time from a table as text, or `key` (the key of the drive) if there is no time."""
    return f"{time:%Y-%m-%d %H:%M}" if time else key


def when_moved(row: Mapping[str, Any]) -> str:
    """Return a text about the time when a sensor was moved. row: row of `analysis/remounts`."""
    before = time_text(row["before"], row["before_log_key"])
    if row["found_s"] is None:
        return f"between {before} and {time_text(row['after'], row['after_log_key'])}"
    return f"within the drive of {before}, found after {clock(row['found_s'])}"


def why_not_known(vehicles: Iterable[Mapping[str, Any]]) -> str:
    """Return the reason why moves between drives could not be found; "" if they could be found.
    vehicles: rows of `analysis/vehicles`."""
    pairs = sum(max(v["drives"] - 1 - v["drives_unordered"], 0) for v in vehicles)
    if pairs >= LEAST_PAIRS:
        return ""
    return (
        f"too few drives: {pairs} of the {LEAST_PAIRS} pairs of successive drives of a vehicle "
        "(with known mounts) that show how drives differ without a move"
    )


def unordered_words(vehicles: Iterable[Mapping[str, Any]]) -> str:
    """Return a text about drives without an order (their number and vehicles); "" if all drives
    have an order.

    vehicles: rows of `analysis/vehicles`.
    """
    mine = [v for v in vehicles if v["drives_unordered"]]
    if not mine:
        return ""
    count = counted(sum(v["drives_unordered"] for v in mine), "drive")
    return (
        f"{count} without an order in time ({names_of(mine)}): overlapping an earlier drive of the "
        "vehicle, or without a time. Moves before them cannot be found. Are the loggers' clocks "
        "right?"
    )
