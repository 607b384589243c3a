"""Past drives' evidence next to this one's: fused with it, never mixed into it.

Both stay apart for as long as the daemon runs, so that every fit can say whether they contradict
one another, and the past ones can be left again. What they have in common is counted once: the
sensor's own errors, and the accelerometer's bias as far as neither drive showed it. What
changes between drives (load, springs) is an error that all earlier evidence of an angle shares.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from msgspec.structs import replace

from imucald.core.arrays import Array
from imucald.core.rotations import Matrix3
from imucald.mount.common_errors import cross_axis_errors
from imucald.mount.estimate import BETWEEN_DRIVES_STD
from imucald.mount.fusion import AXES, MAX_WIDENED, CommonCovariance, CommonError, Fused, fuse
from imucald.mount.road_segments import AngleEvidence
from imucald.mount.saved_information import (
    GRAVITY_KINDS,
    KINDS,
    SavedInformation,
    SavedSource,
    axis_of,
    kept_evidence,
)
from imucald.mount.score_series import ScoreSeries

BEFORE = "_before"
"""Ends the names of past drives' sources."""


class PastDrives:
    """What was kept, as evidence for a `MountSolver`.

    shared: errors that kinds share in it. crown_std: the mean lean of roads differs that much
    from drive to drive [rad].
    """

    def __init__(
        self, kept: SavedInformation, shared: Sequence[CommonError], crown_std: float
    ) -> None:
        self.kept = kept
        roll, pitch, yaw = BETWEEN_DRIVES_STD
        self._between = (math.hypot(roll, crown_std), pitch, yaw)
        self.contradiction = 0.0
        """Of past drives and this one at the last fit: chi-square with 3 degrees of freedom."""
        both = _on_both_sides(shared)
        between = [
            CommonError(std, {name + BEFORE: 1.0 for name in KINDS if axis_of(name) == axis})
            for axis, std in enumerate(self._between)
        ]
        self._shared = (*both, *between)

    @property
    def segments(self) -> int:
        """Road segments of the best known kind."""
        return max((len(p.score) for p in self.kept.sources.values()), default=0)

    def fused(
        self,
        sources: Mapping[str, AngleEvidence],
        R: Matrix3,
        bias: tuple[float, float],
        cross_axis: float = 0.0,
    ) -> Fused:
        """Fuse this drive's sources about R with those of before.

        bias: variance of the accelerometer's bias in roll and pitch from gravity, in the sources.
        cross_axis: error that the sources are probably off by (part).
        """
        turned = self.kept.about(R)
        now, kept, before = dict(sources), turned.sources, kept_evidence(turned)
        shared = [*self._shared, *_on_both_sides(cross_axis_errors(), cross_axis)]
        for name, present in zip(GRAVITY_KINDS, bias, strict=True):
            if name in now and name in kept:
                common = min(present, kept[name].bias)
                shared.append(CommonError(math.sqrt(common), {name: 1.0, name + BEFORE: 1.0}))
                now[name] = _less(now[name], common)
                before[name] = _less(before[name], common)
        named = {name + BEFORE: source for name, source in before.items()}
        sharing = CommonCovariance(shared)
        self.contradiction = _contradiction(now, named, sharing)
        return fuse({**now, **named}, sharing)

    def series(self, now: Mapping[str, ScoreSeries], R: Matrix3) -> list[ScoreSeries]:
        """The series of this drive about R, each behind those of before.

        Those count for no more than what changes between drives lets them.
        """
        kept = self.kept.about(R).sources
        known = np.zeros(3)
        for name, source in kept.items():
            known[axis_of(name)] += source.information.sum()
        part = 1.0 / (1.0 + known * np.square(self._between))
        out = []
        for name, one in now.items():
            known_before = name in kept and len(kept[name].score) > 0
            share = float(part[one.axis])
            out.append(_behind(one, kept[name], share) if known_before else one)
        return out


def _behind(one: ScoreSeries, kept: SavedSource, part: float) -> ScoreSeries:
    """A series behind the kept one, which counts in part; its spread stays what it is."""
    mean = kept.information * (kept.score.sum() / max(float(kept.information.sum()), 1e-12))
    score = part * mean + math.sqrt(part) * (kept.score - mean)
    return one.behind(score, part * kept.information)


def _on_both_sides(shared: Sequence[CommonError], times: float = 1.0) -> list[CommonError]:
    """Errors that a drive shares with those before."""
    return [
        CommonError(times * s.std, {**s.signs, **{name + BEFORE: x for name, x in s.signs.items()}})
        for s in shared
    ]


def _less(source: AngleEvidence, variance: float) -> AngleEvidence:
    return replace(source, variance=source.variance - variance)


def _contradiction(
    now: Mapping[str, AngleEvidence], before: Mapping[str, AngleEvidence], sharing: CommonCovariance
) -> float:
    """Chi-square of the difference of both means, over all angles that both speak of."""
    sources = {**now, **before}
    total = 0.0
    for axis in AXES:
        mine = [name for name in now if name.startswith(axis)]
        theirs = [name for name in before if name.startswith(axis)]
        if not mine or not theirs:
            continue
        V = sharing.covariance(sources, mine + theirs)
        x = np.array([sources[name].value for name in mine + theirs])
        n = len(mine)
        a, wider_a = _mean(V[:n, :n], x[:n])
        b, wider_b = _mean(V[n:, n:], x[n:])
        weight = np.concatenate([a, -b])
        difference = float(weight @ x)
        total += difference**2 / (float(weight @ V @ weight) + wider_a + wider_b)
    return total


def _mean(V: Array, x: Array) -> tuple[Array, float]:
    """Weights of the best mean, and what disagreement adds to its variance (as in `fuse`)."""
    inverse = np.linalg.inv(V)
    weight = np.maximum(inverse.sum(axis=1), 0.0)
    weight /= weight.sum()
    left = x - weight @ x
    disagreement = float(left @ inverse @ left) / max(len(x) - 1, 1)
    wider = min(max(disagreement, 1.0), MAX_WIDENED) - 1.0
    return weight, wider * float(weight @ V @ weight)
