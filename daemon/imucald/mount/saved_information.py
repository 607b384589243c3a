"""Evidence in few numbers: saved when the daemon stops, for the next start.

Each kind of evidence (the rows of `evidence_rows`, and gravity) has a value about the rotation of
that time and a variance. Each kind also has scores and informations per road segment, which the
test for shifts needs. Old segments are joined, so the size is bounded.

The evidence of past drives is fused with that of this drive, but the two are stored separately.

Both stay separate while the daemon runs. Every fit can then tell whether they contradict one
another, and the past evidence can be dropped again. Common errors are counted once: the sensor's
own errors, and the accelerometer's bias as far as neither drive showed it. Changes between drives
(load, springs) are an error that all earlier evidence of an angle shares.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from imucald.core.arrays import Array
from imucald.core.errors import EstimateError
from imucald.core.rotations import Matrix3, orthonormalised, vector_from_rotation
from imucald.mount.common_errors import cross_axis_errors
from imucald.mount.estimate import BETWEEN_DRIVES_STD
from imucald.mount.evidence_gravity import ROAD_SHARE
from imucald.mount.evidence_rows import ROWS
from imucald.mount.fusion import AXES, MAX_WIDENED, CommonCovariance, CommonError, Fused, fuse
from imucald.mount.road_segments import AngleEvidence, ScoreSeries

GRAVITY_KINDS = ("roll_gravity", "pitch_gravity")
KINDS = frozenset((*(row.name for row in ROWS), *GRAVITY_KINDS))
MAX_SEGMENTS = 48
"""Largest number of separate road segments; beyond it, neighbours are joined."""
DIGITS = 6
"""Significant digits that are written: far more than any evidence contains."""
ROTATION_TOLERANCE = 1e-6


class SavedSource(Struct, frozen=True):
    """One kind of evidence about one angle.

    value: [rad] about `SavedInformation.R`. variance: variance of the value without the
    accelerometer's bias. bias: share of that bias (gravity only). score, information: (G,) per road
    segment, about the same R.
    """

    value: float
    variance: float
    bias: float
    score: Array
    information: Array


class SavedInformation(Struct, frozen=True):
    """All kinds of evidence.

    R: the rotation to which they refer, with the crown still in it (see `MountSolver`).
    """

    R: Matrix3
    without_speed: bool
    sources: Mapping[str, SavedSource]

    def about(self, R: Matrix3) -> SavedInformation:
        """Return the same evidence, linearised at another rotation near by (first order)."""
        e = vector_from_rotation(R @ self.R.T)
        turned = {
            name: SavedSource(
                p.value - e[axis_of(name)],
                p.variance,
                p.bias,
                p.score - p.information * e[axis_of(name)],
                p.information,
            )
            for name, p in self.sources.items()
        }
        return SavedInformation(R, self.without_speed, turned)

    def plain(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "rotation": self.R.ravel().tolist(),
            "without_speed": self.without_speed,
            "kinds": {
                name: {
                    "value": float(p.value),
                    "variance": float(p.variance),
                    "bias": float(p.bias),
                    "score": _rounded(p.score),
                    "information": _rounded(p.information),
                }
                for name, p in self.sources.items()
            },
        }


@runtime_checkable
class SavesInformation(Protocol):
    """Additional methods of a `MountEstimator` whose evidence survives the process."""

    @property
    def contradiction(self) -> float | None:
        """Chi-square (3) of this drive's evidence against that of past drives; None without past
        drives.
        """
        ...

    def saved_information(self) -> SavedInformation | None:
        """Information of all evidence, for the next start; None if there is too little."""
        ...

    def join_information(self, kept: SavedInformation) -> None:
        """Add the information that past drives found."""
        ...

    def drop_information(self) -> None:
        """Continue with the evidence of this drive alone."""
        ...


def axis_of(name: str) -> int:
    """Return the angle of a kind of evidence: the name begins with the angle."""
    return AXES.index(name.partition("_")[0])


def named_series(series: list[ScoreSeries]) -> dict[str, ScoreSeries]:
    """Return series by the names of their sources."""
    return {one.kind: one for one in series}


def kept_evidence(kept: SavedInformation) -> dict[str, AngleEvidence]:
    """Return the saved evidence as sources of angles about its rotation."""
    return {
        name: AngleEvidence(
            one.value,
            one.variance + one.bias,
            len(one.score),
            one.variance / ROAD_SHARE[name] if name in ROAD_SHARE else 0.0,
        )
        for name, one in kept.sources.items()
    }


def saved_sources(
    sources: Mapping[str, AngleEvidence],
    series: Mapping[str, ScoreSeries],
    error: Array,
    bias: tuple[float, float],
) -> dict[str, SavedSource]:
    """Return sources and series of a fit about the rotation that the fit found.

    error: (3,), by which the fit turned the rotation. Gravity's series are already about the new
    one. bias: variance of the accelerometer's bias in gravity's sources.
    """
    shares = dict(zip(GRAVITY_KINDS, bias, strict=True))
    found = {}
    for name, source in sources.items():
        e, share, one = float(error[axis_of(name)]), shares.get(name, 0.0), series[name]
        score = one.score if name in shares else one.score - one.information * e
        found[name] = SavedSource(
            source.value - e, source.variance - share, share, score, one.information
        )
    return found


def together(before: SavedInformation | None, now: SavedInformation) -> SavedInformation:
    """Return past and present evidence as one, about the present rotation. The variances of earlier
    sources are widened by the changes between drives.

    The change is the same for all kinds of an angle, but here each kind has its own. The sum is
    therefore slightly too certain, by less than the widening at the next start.
    """
    if before is None or before.without_speed != now.without_speed:
        return _shortened(now)
    turned = before.about(now.R)
    sources = dict(turned.sources)
    for name, new in now.sources.items():
        old = sources.get(name)
        sources[name] = new if old is None else _joined(old, new, BETWEEN_DRIVES_STD[axis_of(name)])
    return _shortened(SavedInformation(now.R, now.without_speed, sources))


def _joined(old: SavedSource, new: SavedSource, between: float) -> SavedSource:
    widened = old.variance + between * between
    share = new.variance / (new.variance + widened)  # of the old
    bias = share * math.sqrt(old.bias) + (1.0 - share) * math.sqrt(new.bias)
    return SavedSource(
        share * old.value + (1.0 - share) * new.value,
        share * widened,
        bias * bias,
        np.concatenate([old.score, new.score]),
        np.concatenate([old.information, new.information]),
    )


def _shortened(kept: SavedInformation) -> SavedInformation:
    sources = {
        name: SavedSource(p.value, p.variance, p.bias, _fewer(p.score), _fewer(p.information))
        for name, p in kept.sources.items()
    }
    return SavedInformation(kept.R, kept.without_speed, sources)


def _fewer(x: Array) -> Array:
    """Return the series with at most `MAX_SEGMENTS` rows: neighbours are summed, equally many in
    each row.
    """
    if len(x) <= MAX_SEGMENTS:
        return x
    starts = np.arange(MAX_SEGMENTS) * len(x) // MAX_SEGMENTS
    out: Array = np.add.reduceat(x, starts)
    return out


def _rounded(x: Array) -> list[float]:
    return [float(f"{value:.{DIGITS}g}") for value in x.tolist()]


def saved_from(content: object) -> SavedInformation:
    """Return the information from the result of `plain`; raises EstimateError where it makes no
    sense.
    """
    try:
        if not isinstance(content, Mapping) or not isinstance(content["without_speed"], bool):
            raise TypeError("not written by imucald")
        R = np.array(_numbers(content["rotation"], 9)).reshape(3, 3)
        if np.abs(orthonormalised(R) - R).max() > ROTATION_TOLERANCE or np.linalg.det(R) < 0.0:
            raise ValueError("no rotation")
        sources = {str(name): _source(str(name), p) for name, p in content["kinds"].items()}
    except (KeyError, TypeError, ValueError, AttributeError, np.linalg.LinAlgError) as error:
        raise EstimateError(f"the saved evidence cannot be used ({error})") from None
    return SavedInformation(R, content["without_speed"], sources)


def _source(name: str, content: Mapping[str, Any]) -> SavedSource:
    if name not in KINDS:
        raise ValueError(f"{name[:20]!r} is no kind of evidence")
    value, variance, bias = _numbers([content[key] for key in ("value", "variance", "bias")], 3)
    score, information = content["score"], content["information"]
    n = len(score)
    if n > MAX_SEGMENTS or abs(value) > math.pi or variance <= 0.0 or bias < 0.0:
        raise ValueError(f"{name} is out of range")
    informations = _numbers(information, n)
    if min(informations, default=0.0) < 0.0:
        raise ValueError(f"{name} has negative information")
    return SavedSource(value, variance, bias, np.array(_numbers(score, n)), np.array(informations))


def _numbers(values: object, n: int) -> list[float]:
    if not isinstance(values, list) or len(values) != n:
        raise ValueError(f"{n} numbers are needed")
    if not all(type(v) in (int, float) and math.isfinite(v) for v in values):
        raise ValueError("a number is missing")
    return [float(v) for v in values]


BEFORE = "_before"
"""Ending of the names of past drives' sources."""


class PastDrives:
    """Saved information as evidence for a `MountSolver`.

    shared: errors that its kinds share. crown_std: change of the mean lean of roads between drives
    [rad].
    """

    def __init__(
        self, kept: SavedInformation, shared: Sequence[CommonError], crown_std: float
    ) -> None:
        self.kept = kept
        roll, pitch, yaw = BETWEEN_DRIVES_STD
        self._between = (math.hypot(roll, crown_std), pitch, yaw)
        self.contradiction = 0.0
        """Chi-square with 3 degrees of freedom between past drives and this one at the last fit."""
        both = _on_both_sides(shared)
        between = [
            CommonError(std, {name + BEFORE: 1.0 for name in KINDS if axis_of(name) == axis})
            for axis, std in enumerate(self._between)
        ]
        self._shared = (*both, *between)

    @property
    def segments(self) -> int:
        """Number of road segments of the best known kind."""
        return max((len(p.score) for p in self.kept.sources.values()), default=0)

    def fused(
        self,
        sources: Mapping[str, AngleEvidence],
        R: Matrix3,
        bias: tuple[float, float],
        cross_axis: float = 0.0,
    ) -> Fused:
        """Fuse this drive's sources about R with those of past drives.

        bias: variance of the accelerometer's bias that the sources of roll and pitch from gravity
        contain. cross_axis: probable cross-axis error of the sources (part).
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
        """Return the series of this drive about R, each after the series of past drives.

        The weight of past series is limited by the changes between drives.
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
    """Return a series after the saved series, which has a smaller weight; its spread stays the
    same."""
    mean = kept.information * (kept.score.sum() / max(float(kept.information.sum()), 1e-12))
    score = part * mean + math.sqrt(part) * (kept.score - mean)
    return one.behind(score, part * kept.information)


def _on_both_sides(shared: Sequence[CommonError], times: float = 1.0) -> list[CommonError]:
    """Return the errors that a drive shares with earlier drives."""
    return [
        CommonError(times * s.std, {**s.signs, **{name + BEFORE: x for name, x in s.signs.items()}})
        for s in shared
    ]


def _less(source: AngleEvidence, variance: float) -> AngleEvidence:
    return replace(source, variance=source.variance - variance)


def _contradiction(
    now: Mapping[str, AngleEvidence], before: Mapping[str, AngleEvidence], sharing: CommonCovariance
) -> float:
    """Return the chi-square of the difference of both means, over all angles that both contain."""
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
    """Return the weights of the best mean, and the variance that disagreement adds (as in
    `fuse`).
    """
    inverse = np.linalg.inv(V)
    weight = np.maximum(inverse.sum(axis=1), 0.0)
    weight /= weight.sum()
    left = x - weight @ x
    disagreement = float(left @ inverse @ left) / max(len(x) - 1, 1)
    wider = min(max(disagreement, 1.0), MAX_WIDENED) - 1.0
    return weight, wider * float(weight @ V @ weight)
