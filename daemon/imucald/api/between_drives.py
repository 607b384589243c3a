"""Find inconsistencies between drives of one vehicle: overlapping times, a changed mount."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from imucald.api.drive import DriveResult
from imucald.can.logs.first_frames import IS_THE_SAME
from imucald.can.logs.overlaps import CLOCK_SET_S, overlap_words
from imucald.core.angles import DEG_PER_RAD
from imucald.core.rotations import vector_from_rotation
from imucald.core.text import clock
from imucald.mount.estimate import BETWEEN_DRIVES_STD, GOOD_NAMES
from imucald.mount.mount_words import is_move

CLOCK_SET_US = round(1e6 * CLOCK_SET_S)
LIKELY = 1e-3
"""Two mounts are reported as different if the probability that chance causes their difference is
below this value."""


def notes_between(drives: Sequence[DriveResult]) -> tuple[str, ...]:
    """Return texts about drives that overlap and about mounts that differ between drives, in order
    of time."""
    timed = [d for d in drives if d.start_us is not None and d.start_us >= CLOCK_SET_US]
    timed.sort(key=lambda d: d.start_us or 0)
    in_order = timed if len(timed) == len(drives) else list(drives)
    return (*_overlaps(timed), *_without_time(drives, timed), *_shifts(in_order))


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


def _shifts(drives: Sequence[DriveResult]) -> Iterator[str]:
    """Yield a text for each pair of successive good drives whose mounts differ by more than chance
    and vehicle load explain.

    If a move of the sensor was found within a drive, only this move is reported. No move is then
    reported between this drive and the previous drive. Drives that overlap in time have no order,
    so their mounts are not compared.
    """
    before: DriveResult | None = None
    is_moved = False
    for drive in drives:
        for shift in filter(is_move, drive.to_dict()["details"].get("shifts", ())):
            is_moved = True
            yield f"the mount was moved within {_name(drive)}, found at {clock(shift['t'])}"
        if drive.state not in GOOD_NAMES or drive.mount is None:
            continue
        is_shared = before is not None and _share(before, drive)
        if before is not None and is_shared and not _is_same(before, drive):
            yield (
                f"the mounts of {_name(before)} and {_name(drive)} were not compared, because "
                "drives that overlap have no order"
            )
        if before is not None and before.mount is not None and not is_moved | is_shared:
            one, other = before.mount, drive.mount
            e = vector_from_rotation(other.matrix @ one.matrix.T) * DEG_PER_RAD
            between = 2.0 * np.diag(np.square(BETWEEN_DRIVES_STD)) * DEG_PER_RAD**2
            p = _chance(e, one.covariance_deg2 + other.covariance_deg2 + between)
            if p < LIKELY:
                turn = ", ".join(f"{axis} {v:+.2f}" for axis, v in zip("xyz", e, strict=True))
                yield (
                    f"the mount was moved between {_name(before)} and {_name(drive)}: "
                    f"by {turn} deg about the vehicle's axes, more than chance explains"
                )
        before, is_moved = drive, False


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
