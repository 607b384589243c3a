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


from typing import NamedTuple

import numpy as np

from imucald.can.logs.recording_files import CLOCK_SET_S, IS_THE_SAME, overlap_words
from imucald.core.angles import DEG_PER_RAD
from imucald.core.rotations import vector_from_rotation
from imucald.core.text import clock
from imucald.mount.estimate import ANGLES, BETWEEN_DRIVES_STD, GOOD_NAMES
from imucald.mount.mount_words import SD_95, is_move


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


CLOCK_SET_US = round(1e6 * CLOCK_SET_S)
LIKELY = 1e-3
"""Two mounts are reported as different if the probability that chance causes their difference is
below this value."""


class BetweenDrives(NamedTuple):
    """What a comparison of drives shows, as texts in order of time.

    notes: drives that overlap, and mounts that differ. agreements: mounts that differ by no more
    than chance, with the 95 % interval of the difference. A smaller move would not show.
    """

    notes: tuple[str, ...]
    agreements: tuple[str, ...]


def between_drives(drives: Sequence[DriveResult]) -> BetweenDrives:
    """Compare drives of one vehicle with each other."""
    timed = [d for d in drives if d.start_us is not None and d.start_us >= CLOCK_SET_US]
    timed.sort(key=lambda d: d.start_us or 0)
    in_order = timed if len(timed) == len(drives) else list(drives)
    compared = list(_compared(in_order))
    notes = [text for is_agreement, text in compared if not is_agreement]
    agreements = tuple(text for is_agreement, text in compared if is_agreement)
    return BetweenDrives((*_overlaps(timed), *_without_time(drives, timed), *notes), agreements)


def _overlaps(drives: Sequence[DriveResult]) -> Iterator[str]:
    latest: DriveResult | None = None
    seen: dict[tuple[int | None, int | None], DriveResult] = {}
    for drive in drives:
        if latest is not None:
            length = ((drive.end_us or 0) - (drive.start_us or 0)) / 1e6
            shared = min(((latest.end_us or 0) - (drive.start_us or 0)) / 1e6, length)
            same = seen.get((drive.start_us, drive.end_us))
            if same is not None and _is_same(same, drive):
                yield f"{log_names(drive)} {IS_THE_SAME} {log_names(same)}"
            elif shared > 0.0:
                yield overlap_words(log_names(drive), log_names(latest), shared, length)
        seen[drive.start_us, drive.end_us] = drive
        if latest is None or (drive.end_us or 0) > (latest.end_us or 0):
            latest = drive


def _is_same(one: DriveResult, other: DriveResult) -> bool:
    return (one.start_us, one.end_us, one.frames) == (other.start_us, other.end_us, other.frames)


def _without_time(drives: Sequence[DriveResult], timed: Sequence[DriveResult]) -> Iterator[str]:
    lacking = [log_names(drive) for drive in drives if drive not in timed]
    if lacking:
        yield (f"these logs have no time of day, so overlaps cannot be found: {', '.join(lacking)}")


def _compared(drives: Sequence[DriveResult]) -> Iterator[tuple[bool, str]]:
    """Yield a text for each pair of successive good drives, with True if their mounts differ by no
    more than chance and vehicle load explain.

    If a move of the sensor was found within a drive, only this move is reported. No move is then
    reported between this drive and the previous drive. Drives that overlap in time have no order,
    so their mounts are not compared.
    """
    before: DriveResult | None = None
    is_moved = False
    for drive in drives:
        for shift in filter(is_move, drive.to_dict()["details"].get("shifts", ())):
            is_moved = True
            found = f"found at {clock(shift['t'])}"
            yield False, f"the mount was moved within {log_names(drive)}, {found}"
        if drive.state not in GOOD_NAMES or drive.mount is None:
            continue
        is_shared = before is not None and _share(before, drive)
        if before is not None and is_shared and not _is_same(before, drive):
            text = "were not compared, because drives that overlap have no order"
            yield False, f"the mounts of {log_names(before)} and {log_names(drive)} {text}"
        if before is not None and before.mount is not None and not is_moved | is_shared:
            one, other = before.mount, drive.mount
            e = vector_from_rotation(other.matrix @ one.matrix.T) * DEG_PER_RAD
            between = 2.0 * np.diag(np.square(BETWEEN_DRIVES_STD)) * DEG_PER_RAD**2
            covariance = one.covariance_deg2 + other.covariance_deg2 + between
            yield _differ(f"{log_names(before)} and {log_names(drive)}", e, covariance)
        before, is_moved = drive, False


def _differ(names: str, e: np.ndarray, covariance: np.ndarray) -> tuple[bool, str]:
    """Return whether two mounts agree, and a text. e: difference (3,) about the vehicle's axes
    [deg]. covariance: (3, 3) [deg^2]."""
    if _chance(e, covariance) < LIKELY:
        turn = ", ".join(f"{axis} {v:+.2f}" for axis, v in zip("xyz", e, strict=True))
        return False, (
            f"the mount was moved between {names}: by {turn} deg about the vehicle's axes, more "
            "than chance explains. For logs of several vehicles use 'imucald fleet'"
        )
    half = SD_95 * np.sqrt(np.diag(covariance))
    turn = ", ".join(
        f"{axis} {v:+.2f} ± {h:.2f}" for axis, v, h in zip("xyz", e, half, strict=True)
    )
    text = f"differ by no more than chance: {turn} deg about the vehicle's axes"
    return True, f"the mounts of {names} {text}"


def _share(one: DriveResult, other: DriveResult) -> bool:
    """Return whether two drives overlap in time. other: the drive that begins later."""
    if one.end_us is None or other.start_us is None or other.start_us < CLOCK_SET_US:
        return False
    return other.start_us < one.end_us


def _chance(e: np.ndarray, covariance: np.ndarray) -> float:
    """Return the probability that chance gives a difference of at least e (3,), from chi-square
    with 3 degrees of freedom."""
    square = float(e @ np.linalg.solve(covariance, e))
    if not math.isfinite(square):
        return 1.0
    half = 0.5 * square
    return math.erfc(math.sqrt(half)) + math.sqrt(4.0 * half / math.pi) * math.exp(-half)
