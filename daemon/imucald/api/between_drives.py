"""Find inconsistencies between drives of one vehicle: overlapping times, a changed mount."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from imucald.api.drive import DriveResult
from imucald.can.logs.recording_files import CLOCK_SET_S, IS_THE_SAME, overlap_words
from imucald.core.angles import DEG_PER_RAD
from imucald.core.rotations import vector_from_rotation
from imucald.core.text import clock
from imucald.mount.estimate import BETWEEN_DRIVES_STD, GOOD_NAMES
from imucald.mount.mount_words import SD_95, is_move

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
                yield f"{_name(drive)} {IS_THE_SAME} {_name(same)}"
            elif shared > 0.0:
                yield overlap_words(_name(drive), _name(latest), shared, length)
        seen[drive.start_us, drive.end_us] = drive
        if latest is None or (drive.end_us or 0) > (latest.end_us or 0):
            latest = drive


def _is_same(one: DriveResult, other: DriveResult) -> bool:
    return (one.start_us, one.end_us, one.frames) == (other.start_us, other.end_us, other.frames)


def _without_time(drives: Sequence[DriveResult], timed: Sequence[DriveResult]) -> Iterator[str]:
    lacking = [_name(drive) for drive in drives if drive not in timed]
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
            yield False, f"the mount was moved within {_name(drive)}, found at {clock(shift['t'])}"
        if drive.state not in GOOD_NAMES or drive.mount is None:
            continue
        is_shared = before is not None and _share(before, drive)
        if before is not None and is_shared and not _is_same(before, drive):
            text = "were not compared, because drives that overlap have no order"
            yield False, f"the mounts of {_name(before)} and {_name(drive)} {text}"
        if before is not None and before.mount is not None and not is_moved | is_shared:
            one, other = before.mount, drive.mount
            e = vector_from_rotation(other.matrix @ one.matrix.T) * DEG_PER_RAD
            between = 2.0 * np.diag(np.square(BETWEEN_DRIVES_STD)) * DEG_PER_RAD**2
            covariance = one.covariance_deg2 + other.covariance_deg2 + between
            yield _differ(f"{_name(before)} and {_name(drive)}", e, covariance)
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
    return True, f"the mounts of {names} agree within chance: {turn} deg about the vehicle's axes"


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


def _name(drive: DriveResult) -> str:
    return ", ".join(drive.logs)
