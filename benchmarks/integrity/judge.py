"""What is misleading, and when it was told: arithmetic on a series of one row a second.

As in records/integrity.md (RTCA DO-229, ICAO Annex 10): alert limit, misleading, time to alert.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

ALERT_LIMIT_DEG = 1.0
DEVIATIONS = 4.0
"""The alert limit is that many stated deviations where these are more."""
INTERVAL = 1.96
MOSTLY = 0.5
"""A second counts as good when so many of its frames are."""
BIN_DECADE = 20
LOWEST_DEG = 0.01


@dataclass(frozen=True)
class Seconds:
    """What was sent in each second (n of them), and what was true.

    moving: it drives. good: share of frames sent as usable or fine. is_fine: any was fine.
    error: (n, 3) of the applied rotation about roll, pitch, yaw [deg], NaN where not known.
    beyond_crown: (n,) the roll error if the mean lean of its roads were known. std: (n, 3) stated.
    reference_std: (3,) how well the truth is known [deg]. wrong: (n,) share of frames that were
    sent as good with a wrong value.
    """

    moving: Flags
    good: Array
    is_fine: Flags
    error: Array
    beyond_crown: Array
    std: Array
    reference_std: Array
    wrong: Array


@dataclass(frozen=True)
class Allowed:
    """How long an alert may take: by the clock or of driving [s]."""

    clock: float = 0.0
    driving: float = 0.0


@dataclass(frozen=True)
class Alert:
    """Time to alert; infinite where none came."""

    clock: float
    driving: float


@dataclass(frozen=True)
class Verdict:
    """Of one drive, from the fault's onset on; times in [s].

    beyond: misleading after the allowed time to alert. at_end: misleading when the drive ended.
    """

    judged: float
    good: float
    fine: float
    misleading: float
    beyond: float
    at_end: bool
    alert: Alert


def bound(seconds: Seconds) -> Array:
    """Alert limit of each second and angle (n, 3) [deg], with what the reference may be off."""
    limit: Array = np.maximum(ALERT_LIMIT_DEG, DEVIATIONS * seconds.std)
    return np.where(np.isfinite(limit), limit, ALERT_LIMIT_DEG) + seconds.reference_std


def limited(seconds: Seconds) -> Array:
    """The errors that are held against the alert limit (n, 3): roll beyond the crown."""
    errors = np.abs(seconds.error)
    errors[:, 0] = np.abs(seconds.beyond_crown)
    return errors


def misleading(seconds: Seconds) -> Array:
    """Share of each second that was sent as good and is wrong (n,)."""
    lost = (limited(seconds) > bound(seconds)).any(axis=1)  # NaN is not beyond
    return np.maximum(seconds.good * lost, seconds.wrong)


def judged(
    seconds: Seconds, onset: float, allowed: Allowed, told: tuple[float, float] | None = None
) -> Verdict:
    """Judge a drive whose fault begins at `onset`.

    told: for faults whose every frame is wrong, from which frame sent as good to which that is not
    (`until_told`). None: the fault becomes wrong when the error exceeds the alert limit, and is
    told when frames are no longer good, or is over when they are right for good.
    """
    n = len(seconds.good)
    first = min(int(onset), n)
    wrong = misleading(seconds)
    wrong[:first] = 0.0
    bad = np.flatnonzero(wrong > 0.0)
    driven = np.concatenate([[0.0], np.cumsum(seconds.moving)])
    if told is None and len(bad):
        told = float(bad[0]), _told(seconds.good, wrong, int(bad[0]))
    begun, ended = told or (onset, onset)
    late = np.arange(n) - begun >= allowed.clock if allowed.clock else np.ones(n, dtype=bool)
    late &= driven[:-1] - _at(driven, begun) >= allowed.driving
    driving = math.inf if math.isinf(ended) else _at(driven, ended) - _at(driven, begun)
    return Verdict(
        judged=float(n - first),
        good=float(seconds.good[first:].sum()),
        fine=float(seconds.is_fine[first:].sum()),
        misleading=float(wrong.sum()),
        beyond=float(wrong[late].sum()),
        at_end=bool(n and wrong[-1] > 0.0),
        alert=Alert(ended - begun, driving),
    )


def _told(good: Array, wrong: Array, first: int) -> float:
    """When frames stopped to be good after the second `first`, or were right for good."""
    not_good = np.flatnonzero(good[first:] < MOSTLY)
    if len(not_good):
        return float(first + not_good[0])
    return math.inf if wrong[-1] > 0.0 else float(np.flatnonzero(wrong > 0.0)[-1] + 1)


def _at(driven: Array, t: float) -> float:
    """Seconds driven up to a time."""
    return float(np.interp(t, np.arange(len(driven)), driven))


def until_told(t: Array, good: Flags, onset: float) -> tuple[float, float]:
    """From the first good frame at or after the onset to the next that is not good.

    t: (N,) of frames. Infinite where none follows; twice the onset where no frame is good.
    """
    at = int(np.searchsorted(t, onset - 1e-9))
    fair = np.flatnonzero(good[at:])
    if not len(fair):
        return onset, onset
    begun = at + int(fair[0])
    bad = np.flatnonzero(~good[begun:])
    return float(t[begun]), float(t[begun + bad[0]]) if len(bad) else math.inf


def coverage(seconds: Seconds, onset: float) -> tuple[list[int], int, int]:
    """Of the good seconds: hits of the 95 % interval by angle, those all within 3 sd, and all."""
    use = (seconds.good >= MOSTLY) & (np.arange(len(seconds.good)) >= int(onset))
    e, std = np.abs(seconds.error[use]), np.hypot(seconds.std[use], seconds.reference_std)
    known = np.isfinite(e).all(axis=1) & np.isfinite(std).all(axis=1)
    e, std = e[known], std[known]
    hits = (e <= INTERVAL * std).sum(axis=0).tolist()
    return hits, int((e <= 3.0 * std).all(axis=1).sum()), int(known.sum())


def points(seconds: Seconds, onset: float) -> dict[str, int]:
    """Seconds by cell "i,j" of the Stanford diagram: true error and stated bound of the angle that
    is nearest to its limit, BIN_DECADE cells a decade from LOWEST_DEG."""
    use = (seconds.good >= MOSTLY) & (np.arange(len(seconds.good)) >= int(onset))
    errors = limited(seconds)[use]
    std = np.hypot(seconds.std[use], seconds.reference_std / DEVIATIONS)
    ratio = np.nan_to_num(errors / bound(seconds)[use], nan=-1.0)
    worst = ratio.argmax(axis=1)
    rows = np.flatnonzero((ratio.max(axis=1, initial=-1.0) >= 0.0) & np.isfinite(std).all(axis=1))
    found: dict[str, int] = {}
    for row in rows:
        e, s = errors[row, worst[row]], DEVIATIONS * std[row, worst[row]]
        key = f"{_cell(e)},{_cell(s)}"
        found[key] = found.get(key, 0) + 1
    return found


def _cell(degrees: float) -> int:
    return max(0, math.floor(BIN_DECADE * math.log10(max(degrees, LOWEST_DEG) / LOWEST_DEG)))


def lost_again(t: Array, quality: NDArray[np.int64], apart: float = 2.0) -> tuple[int, int]:
    """How often frames ceased to be good: as suspect, and as not available (0 or restored).

    Such times that lie less than `apart` [s] from the last frame that was not good are one.
    """
    good = (quality == 2) | (quality == 3)
    if not good.any():
        return 0, 0
    bad = np.flatnonzero(~good)
    bad = bad[bad > int(np.argmax(good))]
    if not len(bad):
        return 0, 0
    begins = bad[np.concatenate([[True], np.diff(t[bad]) > apart])]
    suspect = int((quality[begins] == 4).sum())
    return suspect, len(begins) - suspect
