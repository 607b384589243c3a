"""The result of a replay: `imucald.DriveResult`."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

from imucald.api.columns import Columns
from imucald.api.configuration import PathLike
from imucald.api.mount import CorrectionResult, MountResult
from imucald.api.table_access import TableAccess

if TYPE_CHECKING:
    from imucald.api.plots import DrivePlots

WIDTH = 96
"""Longest line of the text that `repr` returns [characters]."""


@dataclass(frozen=True, eq=False, repr=False)
class DriveResult(TableAccess):
    """One replayed drive. Times are in seconds since the log's first frame, angles in degrees.

    logs: names of the files. mount: the orientation of the sensor at the end of the drive; None if
    there is no estimate. state, waiting_for, first_usable_s, first_fine_s, frames, duration_s: as
    in `replay --json`, see docs/json.md. start_us, end_us: the log's times of the first and last
    used frame, in microseconds since 1970; None if no frame was used. problems: the first bad
    lines, as texts with file and line. notes: further remarks for the user, as texts.
    """

    logs: tuple[str, ...]
    mount: MountResult | None
    state: str
    waiting_for: Mapping[str, str]
    first_usable_s: float | None
    first_fine_s: float | None
    frames: Mapping[str, Any]
    duration_s: float
    start_us: int | None
    end_us: int | None
    problems: tuple[str, ...]
    notes: tuple[str, ...]
    summary: Mapping[str, Any]
    """The complete output of `replay --json`."""
    tables: Mapping[str, Columns] = field(default_factory=dict)
    """All tables by name, for internal use."""

    @property
    def correction(self) -> CorrectionResult | None:
        """The correction of the samples, with standard deviations; None if there is no estimate."""
        return CorrectionResult.from_summary(self.summary.get("correction"))

    @property
    def start(self) -> datetime | None:
        """The log's time of the first used frame (UTC). Many loggers start their clock at 1970."""
        return _day(self.start_us)

    @property
    def end(self) -> datetime | None:
        """The log's time of the last used frame (UTC)."""
        return _day(self.end_us)

    def write(self, path: PathLike, quantities: Sequence[str] | str | None = None) -> list[Path]:
        """Write tables to files and return their paths. The suffix of `path` sets the format.

        .parquet, .csv: one file per table in one folder, such as drive.accel.parquet; a single
        table is written to `path` itself. .mf4: one channel group per table. .mcap: one topic per
        table. quantities: names of tables; "raw" means all raw samples; None means all tables
        except the raw samples. `open_result` reads the files again. Raises ImucaldError if a
        library is missing or a file cannot be written. No partial file is left in that case.
        """
        tables = {name: table.columns for name, table in self.tables.items()}
        from imucald.api.files.written import chosen, write_parts  # noqa: PLC0415

        there = chosen(tables, quantities)
        return write_parts(Path(path), there, [self.tables], lambda: drive_plain(self))

    @property
    def plot(self) -> DrivePlots:
        """Plots, drawn with matplotlib (the extra "report"), which is loaded by the first plot."""
        from imucald.api.plots import DrivePlots  # noqa: PLC0415

        return DrivePlots(self.tables, self.summary)

    def to_dict(self) -> dict[str, Any]:
        """Return a copy of the output of `imucald replay --json`, as plain data."""
        return copy.deepcopy(dict(self.summary))

    def _repr_html_(self) -> str:
        """Return the HTML that a notebook shows."""
        from imucald.api.html import drive_html  # noqa: PLC0415

        return drive_html(self.logs, self.mount, self.summary, tuple(self.tables), self.notes)

    def __repr__(self) -> str:
        usable = "never" if self.first_usable_s is None else f"after {self.first_usable_s:.1f} s"
        frames = f"{self.frames['read']} frames read, {self.frames['used']} used"
        lines = (
            f"Drive of {', '.join(self.logs)}",
            f"  {self.mount or 'Mount(none yet)'}",
            f"  state {self.state}, usable {usable}",
            f"  {self.duration_s:.1f} s, {frames}",
            f"  tables: {', '.join(self.tables)}",
            *(f"  note: {note}" for note in self.notes),
        )
        return "\n".join(line if len(line) <= WIDTH else f"{line[:WIDTH]}..." for line in lines)


def drive_result(
    logs: tuple[str, ...],
    mount: MountResult | None,
    summary: Mapping[str, Any],
    span_us: tuple[int, int] | None,
    problems: tuple[str, ...],
    notes: tuple[str, ...],
    tables: Mapping[str, Columns],
) -> DriveResult:
    """Make a result from the content of `replay --json` and from data that it does not contain."""
    return DriveResult(
        logs=logs,
        mount=mount,
        state=summary["state"],
        waiting_for=summary["waiting_for"],
        first_usable_s=summary["first_usable_s"],
        first_fine_s=summary["first_fine_s"],
        frames=summary["frames"],
        duration_s=summary["duration_s"],
        start_us=None if span_us is None else span_us[0],
        end_us=None if span_us is None else span_us[1],
        problems=problems,
        notes=notes,
        summary=summary,
        tables=tables,
    )


def drive_plain(drive: DriveResult) -> dict[str, Any]:
    """Return the data of a drive that a file stores in addition to the tables."""
    return {
        "logs": list(drive.logs),
        "mount": None if drive.mount is None else drive.mount.plain(),
        "start_us": drive.start_us,
        "end_us": drive.end_us,
        "problems": list(drive.problems),
        "notes": list(drive.notes),
        "result": drive.summary,
    }


def drive_from_plain(content: Mapping[str, Any], tables: Mapping[str, Columns]) -> DriveResult:
    """Rebuild a drive from the output of `drive_plain` and its tables."""
    start, end = content["start_us"], content["end_us"]
    return drive_result(
        logs=tuple(content["logs"]),
        mount=MountResult.from_plain(content["mount"]),
        summary=content["result"],
        span_us=None if start is None or end is None else (start, end),
        problems=tuple(content["problems"]),
        notes=tuple(content["notes"]),
        tables=tables,
    )


def _day(us: int | None) -> datetime | None:
    if us is None:
        return None
    try:
        return datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=us)
    except OverflowError:  # a damaged time stamp
        return None
