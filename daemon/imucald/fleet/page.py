"""The analysis of a fleet as a self-contained HTML page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime
from types import ModuleType
from typing import Any

import pyarrow.compute as pc

from imucald import __version__
from imucald.core.text import counted
from imucald.fleet.compaction import read_tables
from imucald.fleet.reading import (
    has_common_mount,
    names_of,
    no_common_mount_words,
    present_mounts,
    read_analysis,
    shown_types,
    spread_text,
    time_text,
    unordered_words,
    when_moved,
    why_not_known,
)
from imucald.fleet.store import Store
from imucald.mount.estimate import GOOD_NAMES
from imucald.mount.mount_words import UNKNOWN_HALF_DEG
from imucald.report.page import address_of, environment, require_libraries

MAX_ROWS = 60
"""Largest number of rows of a table on the page. The files contain all rows."""
MAX_HISTORIES = 6
"""Largest number of vehicles with a picture of their drives."""
MAX_PICTURED = 4000
"""Largest number of vehicles in one picture. If there are more vehicles, all outliers but only a
sample of the other vehicles are drawn."""
CALM = "Nothing stands out"
Rows = list[dict[str, Any]]


def fleet_page(store: Store) -> str:
    """Return the page as text. Raises ImucaldError if there is no analysis or a library is
    missing."""
    require_libraries()
    analysis = {
        name.rpartition("/")[2]: table.to_pylist() for name, table in read_analysis(store).items()
    }
    tables = read_tables(store, ("drives", "failures", "sources"))
    drives, failures = tables["drives"], tables["failures"]
    found = [r for r in analysis["remounts"] if r["found"]]
    bad = [g for g in analysis["groups"] if g["verdict"] == "bad"]
    design = [c for c in analysis["causes"] if c["verdict"] == "design"]
    unknown = why_not_known(analysis["vehicles"])
    hours = (pc.sum(drives.column("duration_s")).as_py() or 0.0) / 3600.0
    kinds = counted(len(analysis["types"]), "type")
    return environment().get_template("fleet.html").render(
        place=store.url,
        made=f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC, imucald {__version__}",
        headline=_headline(found, analysis["outliers"], bad, design, are_moves_known=not unknown),
        figures=[
            ("Vehicles", str(len(analysis["vehicles"])), f"of {kinds}"),
            ("Drives", f"{len(drives)}", f"{hours:.{0 if hours >= 10.0 else 1}f} h of driving"),
            (
                "Moved sensors",
                f"{len(found) or ('not known' if unknown else 0)}",
                "of those between drives, at most 5 % are false",
            ),
            ("Vehicles that differ clearly", f"{len(analysis['outliers'])}", "from their type"),
            ("Bad batches", *_bad_batches(len(bad), analysis["groups"])),
            ("Failed logs", f"{len(failures)}", f"of {tables['sources'].num_rows}"),
        ],
        mounts=_mounts(analysis)[:MAX_ROWS],
        more_mounts=max(0, len(analysis["vehicles"]) - MAX_ROWS),
        types=shown_types(analysis["types"][:MAX_ROWS]),
        unknown_half=UNKNOWN_HALF_DEG,
        spread=spread_text,
        no_common_mount=no_common_mount_words(analysis["types"]),
        remounts_not_known=unknown,
        unordered=unordered_words(analysis["vehicles"]),
        when_moved=when_moved,
        time_text=time_text,
        remounts=sorted(found, key=lambda r: r["q"] or 0.0)[:MAX_ROWS],
        outliers=sorted(analysis["outliers"], key=lambda r: r["q"])[:MAX_ROWS],
        groups=sorted(analysis["groups"], key=_by_p)[:MAX_ROWS],
        causes=sorted(analysis["causes"], key=lambda c: c["q"])[:MAX_ROWS],
        never=analysis["never_usable"][:MAX_ROWS],
        failures=_failures(failures.to_pylist()),
        pictures=_pictures(analysis),
        histories=_histories(found, drives),
        more=max(0, len(found) - MAX_ROWS),
    )  # fmt: skip


def _bad_batches(bad: int, groups: Rows) -> tuple[str, str]:
    """Return the number of bad batches, and how many groups were compared, as texts."""
    compared = sum(g["p"] is not None for g in groups)
    return (
        (str(bad), f"of {compared} compared") if compared else ("not known", "none is comparable")
    )


def _by_p(group: dict[str, Any]) -> float:
    return 2.0 if group["p"] is None else float(group["p"])


def _headline(found: Rows, outliers: Rows, bad: Rows, design: Rows, are_moves_known: bool) -> str:
    named = [
        (len(bad), "bad batch", "bad batches", ", ".join(g["name"] for g in bad)),
        (len(design), "fault of many vehicles", "faults of many vehicles", ""),
        (len(outliers), "vehicle stands out", "vehicles stand out", names_of(outliers)),
        (len(found), "move of a sensor", "moves of sensors", names_of(found)),
    ]
    parts = [
        f"{n} {one if n == 1 else many}" + (f" ({names})" if names else "")
        for n, one, many, names in named
        if n
    ]
    if parts:
        return ", ".join(parts)
    return CALM if are_moves_known else f"{CALM}; moves between drives are not known"


def _mounts(analysis: dict[str, Rows]) -> Rows:
    """Return the present mount of each vehicle, in order of importance: vehicles with a moved
    sensor first, then outliers.

    The column mark is the reason for attention; "" if there is none.
    """
    odd = {row["vehicle"] for row in analysis["outliers"]}
    rows = present_mounts(analysis["vehicles"], analysis["segments"], analysis["remounts"])
    for row in rows:
        moves = f"moved {counted(row['moves'], 'time')}" if row["moves"] else ""
        row["mark"] = ", ".join(filter(None, (moves, "stands out" * (row["vehicle"] in odd))))
    return sorted(rows, key=lambda row: (not row["moves"], not row["mark"]))


def _failures(failures: Rows) -> Rows:
    count = Counter(row["kind"] for row in failures)
    example = {row["kind"]: row["message"] for row in reversed(failures)}
    return [{"kind": k, "logs": n, "example": example[k]} for k, n in count.most_common()]


def _drawing() -> ModuleType:
    from imucald.fleet import pictures  # noqa: PLC0415 - loads matplotlib

    return pictures


def _pictures(analysis: dict[str, Rows]) -> dict[str, str]:
    draw, found = _drawing(), dict[str, str]()
    types = [row for row in analysis["types"] if has_common_mount(row)]
    names = {row["vehicle_type"] for row in types}
    vehicles = [v for v in analysis["vehicles"] if v["vehicle_type"] in names]
    if vehicles:
        step = -(-len(vehicles) // MAX_PICTURED)
        shown = [v for i, v in enumerate(vehicles) if i % step == 0 or v["outlier"]]
        found["vehicles"] = draw.vehicles_picture(shown)
        found["types"] = draw.types_picture(types)
    if any(g["p"] is not None for g in analysis["groups"]):
        found["groups"] = draw.groups_picture(analysis["groups"])
    if analysis["never_usable"]:
        found["never"] = draw.reasons_picture(analysis["never_usable"])
    pictures = ("vehicles", "types", "groups", "never")
    return {name: address_of(found[name]) if name in found else "" for name in pictures}


def _histories(found: Sequence[dict[str, Any]], drives: Any) -> Rows:
    """Return the histories of the vehicles whose sensors were moved by the largest angles."""
    cuts: dict[str, list[str]] = {}
    for row in sorted(found, key=lambda r: -(r["size_deg"] or 0.0)):
        cuts.setdefault(row["vehicle"], []).append(row["after_log_key"])
    rows = []
    for vehicle, keys in list(cuts.items())[:MAX_HISTORIES]:
        mine = drives.filter(pc.equal(drives.column("vehicle"), vehicle)).to_pylist()
        mine = [d for d in mine if d["state"] in GOOD_NAMES and d["q_w"] is not None]
        if mine:  # none if its only drive had a move and ended without a good mount
            picture = address_of(_drawing().history_picture(mine, keys))
            rows.append({"vehicle": vehicle, "picture": picture})
    return rows
