"""Several drives: one result per drive, and notes on inconsistencies between the drives."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

from imucald.api.drive import DriveResult
from imucald.api.html import html_table
from imucald.api.interchange import library
from imucald.core.text import counted
from imucald.mount.mount_words import CONVENTION, angle_text

if TYPE_CHECKING:
    import pandas as pd

ANGLES = ("roll", "pitch", "yaw")


@dataclass(frozen=True, eq=False, repr=False)
class DriveSet:
    """The results of several drives with one configuration. Each drive was replayed separately. The
    order of the drives is the order of the logs in the call.

    notes: texts about drives that overlap in time or are given twice, and about mounts that differ
    too much from one drive to the next. agreements: texts about mounts that agree, with the 95 %
    interval of their difference. failed: name and reason of each log that could not be read.
    """

    drives: tuple[DriveResult, ...]
    notes: tuple[str, ...]
    agreements: tuple[str, ...] = ()
    failed: tuple[tuple[str, str], ...] = ()

    def __len__(self) -> int:
        return len(self.drives)

    def __iter__(self) -> Iterator[DriveResult]:
        return iter(self.drives)

    def __getitem__(self, index: int) -> DriveResult:
        return self.drives[index]

    def rows(self) -> list[dict[str, Any]]:
        """One row per drive: log, start, duration_s, state, angles and their deviations [deg]."""
        return [_row(drive) for drive in self.drives]

    def to_pandas(self) -> pd.DataFrame:
        """Return the rows as a pandas frame (needs the extra "pandas")."""
        frame: pd.DataFrame = library("pandas", "pandas").DataFrame(self.rows())
        return frame

    def to_dict(self) -> dict[str, Any]:
        """Return the output of `imucald replay --json` for several drives."""
        drives = [{"log": log_names(drive), **drive.to_dict()} for drive in self.drives]
        return {
            "drives": drives,
            "notes": list(self.notes),
            "agreements": list(self.agreements),
            "failed": [{"log": log, "reason": reason} for log, reason in self.failed],
        }

    def __repr__(self) -> str:
        states = ", ".join(drive.state for drive in self.drives)
        return (
            f"{counted(len(self.drives), 'drive')}: {states}"[:96]
            + (f"\n  {counted(len(self.notes), 'note')}")
            + (
                f"\n  not read: {', '.join(log for log, _ in self.failed)}"[:96]
                if self.failed
                else ""
            )
        )

    def _repr_html_(self) -> str:
        """Return the HTML that a notebook shows."""
        rows = []
        for row in self.rows():
            angles = [angle_text(row[f"{a}_deg"], row[f"std_{a}_deg"]) for a in ANGLES]
            rows.append([row["log"], f"{row['duration_s']:.1f}", row["state"], *angles])
        table = html_table(("log", "s", "state", *ANGLES), rows)
        failed = [f"not read: {reason}" for _, reason in self.failed]
        notes = [[note] for note in (*failed, *self.notes, *self.agreements)]
        return f"{table}<p>{CONVENTION}</p>{html_table(('notes',), notes)}"


def log_names(drive: DriveResult) -> str:
    """Return the names of a drive's log files as one text."""
    return ", ".join(drive.logs)


def _row(drive: DriveResult) -> dict[str, Any]:
    mount = drive.mount
    found: dict[str, Any] = {
        "log": log_names(drive),
        "start": drive.start,
        "duration_s": drive.duration_s,
        "state": drive.state,
        "first_usable_s": drive.first_usable_s,
    }
    for angle in ANGLES:
        found[f"{angle}_deg"] = None if mount is None else float(getattr(mount, f"{angle}_deg"))
    for i, axis in enumerate("xyz"):
        found[f"std_{axis}_deg"] = None if mount is None else mount.std_deg[i]
    for i, angle in enumerate(ANGLES):
        std = math.inf if mount is None else mount.angle_std_deg[i]
        found[f"std_{angle}_deg"] = std if math.isfinite(std) else None
    return found


def names_apart(logs: Sequence[str]) -> list[str]:
    """Return a short name for each log: the file name, with the folder if names are equal."""
    stems = [PurePath(PurePath(log).name.removesuffix(".gz")).stem or "drive" for log in logs]
    found: list[str] = []
    for log, stem in zip(logs, stems, strict=True):
        folder = PurePath(log).parent.name
        word = name = f"{folder}-{stem}" if stems.count(stem) > 1 and folder else stem
        number = 2
        while word in found:
            word, number = f"{name}-{number}", number + 1
        found.append(word)
    return found
