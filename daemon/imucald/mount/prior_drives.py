"""Earlier drives' evidence beside this one's: fused with it, never mixed into it.

Both stay apart for as long as the daemon runs, so that every fit can say whether they contradict
one another, and the earlier ones can be left again. What they have in common is counted once: the
sensor's own errors, and the accelerometer's bias as far as neither drive could tell it. What
changes between drives (load, springs) is an error that all earlier evidence of an angle shares.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from imucald.core.rotations import Matrix3
from imucald.mount.estimate import BETWEEN_DRIVES_STD
from imucald.mount.fusion import AXES, MOST_WIDENED, Fused, Shared, Sharing, fuse
from imucald.mount.road_segments import Piece
from imucald.mount.saved_information import GRAVITY_KINDS, KINDS, KeptEvidence, KeptPiece, axis_of
from imucald.mount.shift import Flow

Array = NDArray[np.float64]

BEFORE = "_before"
"""Ends the names of earlier drives' pieces."""


class EarlierDrives:
    """What was kept, as evidence for a `Solution`.

    shared: errors that kinds share in it. crown_std: the mean lean of roads differs that much
    from drive to drive [rad].
    """

    def __init__(self, kept: KeptEvidence, shared: Sequence[Shared], crown_std: float) -> None:
        self.kept = kept
        roll, pitch, yaw = BETWEEN_DRIVES_STD
        self._between = (math.hypot(roll, crown_std), pitch, yaw)
        self.contradiction = 0.0
        """Of earlier drives and this one at the last fit: chi-square with 3 degrees of freedom."""
        both = [
            Shared(s.std, {**s.signs, **{name + BEFORE: x for name, x in s.signs.items()}})
            for s in shared
        ]
        between = [
            Shared(std, {name + BEFORE: 1.0 for name in KINDS if axis_of(name) == axis})
            for axis, std in enumerate(self._between)
        ]
        self._shared = (*both, *between)

    def fused(self, pieces: Mapping[str, Piece], R: Matrix3, bias: tuple[float, float]) -> Fused:
        """Fuse this drive's pieces about R with those of before.

        bias: variance of the accelerometer's bias in roll and pitch from gravity, in the pieces.
        """
        now, kept = dict(pieces), self.kept.about(R).pieces
        before = {n: Piece(p.value, p.variance + p.bias, len(p.score)) for n, p in kept.items()}
        shared = list(self._shared)
        for name, present in zip(GRAVITY_KINDS, bias, strict=True):
            if name in now and name in kept:
                common = min(present, kept[name].bias)
                shared.append(Shared(math.sqrt(common), {name: 1.0, name + BEFORE: 1.0}))
                now[name] = _less(now[name], common)
                before[name] = _less(before[name], common)
        named = {name + BEFORE: piece for name, piece in before.items()}
        sharing = Sharing(shared)
        self.contradiction = _contradiction(now, named, sharing)
        return fuse({**now, **named}, sharing)

    def flows(self, now: Mapping[str, Flow], R: Matrix3) -> list[Flow]:
        """The flows of this drive about R, each behind those of before.

        Those count for no more than what changes between drives lets them.
        """
        kept = self.kept.about(R).pieces
        known = np.zeros(3)
        for name, piece in kept.items():
            known[axis_of(name)] += piece.information.sum()
        part = 1.0 / (1.0 + known * np.square(self._between))
        out = []
        for name, flow in now.items():
            known_before = name in kept and len(kept[name].score) > 0
            share = float(part[flow.axis])
            out.append(_behind(flow, kept[name], share) if known_before else flow)
        return out


def _behind(flow: Flow, kept: KeptPiece, part: float) -> Flow:
    """A flow behind the kept one, which counts in part; its spread stays what it is."""
    mean = kept.information * (kept.score.sum() / max(float(kept.information.sum()), 1e-12))
    score = part * mean + math.sqrt(part) * (kept.score - mean)
    return flow.behind(score, part * kept.information)


def _less(piece: Piece, variance: float) -> Piece:
    return Piece(piece.value, piece.variance - variance, piece.groups)


def _contradiction(
    now: Mapping[str, Piece], before: Mapping[str, Piece], sharing: Sharing
) -> float:
    """Chi-square of the difference of both means, over all angles that both speak of."""
    pieces = {**now, **before}
    total = 0.0
    for axis in AXES:
        mine = [name for name in now if name.startswith(axis)]
        theirs = [name for name in before if name.startswith(axis)]
        if not mine or not theirs:
            continue
        V = sharing.covariance(pieces, mine + theirs)
        x = np.array([pieces[name].value for name in mine + theirs])
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
    wider = min(max(disagreement, 1.0), MOST_WIDENED) - 1.0
    return weight, wider * float(weight @ V @ weight)
