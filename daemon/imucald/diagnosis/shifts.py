"""A shift of the mount at an unknown time."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from imucald.diagnosis.causes import mount_shift
from imucald.diagnosis.evidence import solve
from imucald.diagnosis.linear import Linearised, residual_blocks
from imucald.diagnosis.spectra import HOP
from imucald.diagnosis.trial import Found, Trial

if TYPE_CHECKING:
    from imucald.diagnosis.search import Search

SHIFT_MARGIN = 3
"""Stretches at both ends of the drive within which a shift cannot be told."""


def places(found: Found) -> int:
    """Number of times at which a shift is looked for."""
    return len(found.point.present) - 2 * SHIFT_MARGIN


def shift_trials(search: Search, found: Found) -> list[Trial]:
    """Try a shift of the mount at every stretch's middle: columns of the mount, cut."""
    normal, evidence = found.point.evidence.normal, found.point.evidence
    variant = next(v for v in search.variants if v.cause == "mount_shift")
    mount = [search.index[f"_mount.{axis}"] for axis in "xyz"]
    shift = [search.index[key] for key in mount_shift.KEYS]
    temper = search.temper(found, [f"_mount.{axis}" for axis in "xyz"])
    without = evidence.fit(found.keys, temper=temper)
    precision = evidence.precision([*found.keys, *mount_shift.KEYS])
    after_A = np.cumsum(normal.information[::-1], axis=0)[::-1]
    after_g = np.cumsum(normal.score[::-1], axis=0)[::-1]
    count = len(normal.score)
    tried = []
    places = range(SHIFT_MARGIN, count - SHIFT_MARGIN)
    for b in places:
        A, g = evidence.A.copy(), evidence.g.copy()
        A[shift, :] = after_A[b][mount, :]
        A[:, shift] = after_A[b][:, mount]
        A[np.ix_(shift, shift)] = after_A[b][np.ix_(mount, mount)]
        g[shift] = after_g[b][mount]
        fit = solve(A / temper, g / temper, evidence.square / temper, precision, evidence.shift)
        score = fit.log_evidence - without.log_evidence + search.prior(variant)
        start = {key: float(fit.x[i]) for key, i in zip(mount_shift.KEYS, shift, strict=True)}
        start[mount_shift.TIME] = _time(search, b)
        tried.append(Trial(variant, score - math.log(len(places)), start))
    return tried


def _time(search: Search, block: int) -> float:
    """Time [s] at which a stretch begins to be new."""
    for forward in search.forwards:
        starts = max(len(forward.track.t) - 2 * HOP, 0) // HOP + 1
        if block < starts:
            return float(forward.track.t[min(block * HOP + HOP // 2, len(forward.track.t) - 1)])
        block -= starts
    return 0.0


def timed(search: Search, point: Linearised, values: dict[str, float]) -> dict[str, float]:
    """Move the time of the shift to where the residual is least."""
    best, least = values, math.inf
    first, last = _time(search, SHIFT_MARGIN), _time(search, len(point.present) - SHIFT_MARGIN - 1)
    for step in (-24.0, -12.0, -6.0, -3.0, 0.0, 3.0, 6.0, 12.0, 24.0):
        moved = dict(values)
        moved[mount_shift.TIME] = min(max(values[mount_shift.TIME] + step, first), last)
        _, square = point.at([residual_blocks(f, moved) for f in search.forwards])
        if square < least:
            best, least = moved, square
    return best
