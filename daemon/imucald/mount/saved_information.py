"""What evidence comes to, in few numbers: kept when the daemon stops, for the next start.

Per kind of evidence (the rows of `evidence_rows`, and gravity) there are its value about the
rotation of that time, its variance, and its scores and informations road segment by road
segment, which the test for shifts needs. Old sources are joined: the size is bounded.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

import numpy as np
from msgspec import Struct

from imucald.core.arrays import Array
from imucald.core.errors import EstimateError
from imucald.core.rotations import Matrix3, orthonormalised, vector_from_rotation
from imucald.mount.estimate import BETWEEN_DRIVES_STD
from imucald.mount.evidence_gravity import ROAD_SHARE
from imucald.mount.evidence_rows import ROWS
from imucald.mount.fusion import AXES
from imucald.mount.road_segments import AngleEvidence
from imucald.mount.score_series import ScoreSeries

GRAVITY_KINDS = ("roll_gravity", "pitch_gravity")
KINDS = frozenset((*(row.name for row in ROWS), *GRAVITY_KINDS))
MAX_SEGMENTS = 48
"""Road segments kept apart; neighbours are joined beyond."""
DIGITS = 6
"""Significant digits that are written: far more than there is in any evidence."""
ROTATION_TOLERANCE = 1e-6


class SavedSource(Struct, frozen=True):
    """One kind of evidence about one angle.

    value: [rad] about `SavedInformation.R`. variance: of it, without the accelerometer's bias,
    whose share is in bias (gravity only). score, information: (G,) by road segment, about the same
    R.
    """

    value: float
    variance: float
    bias: float
    score: Array
    information: Array


class SavedInformation(Struct, frozen=True):
    """All kinds. R: the rotation they are about, crown still in it (see `MountSolver`)."""

    R: Matrix3
    without_speed: bool
    sources: Mapping[str, SavedSource]

    def about(self, R: Matrix3) -> SavedInformation:
        """The same about another rotation near by, to first order."""
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
        """As JSON takes it."""
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
    """What a `MountEstimator` has besides its verbs if its evidence outlives the process."""

    @property
    def contradiction(self) -> float | None:
        """Chi-square (3) of past drives' evidence against this one's; None without any."""
        ...

    def saved_information(self) -> SavedInformation | None:
        """What all evidence comes to, for the next start; None where there is too little."""
        ...

    def join_information(self, kept: SavedInformation) -> None:
        """Go on with what past drives found as well."""
        ...

    def drop_information(self) -> None:
        """Go on with this drive's evidence alone."""
        ...


def axis_of(name: str) -> int:
    """Which angle a kind of evidence is about: its name begins with it."""
    return AXES.index(name.partition("_")[0])


def named_series(series: list[ScoreSeries]) -> dict[str, ScoreSeries]:
    """Flows by the names of their sources."""
    return {one.kind: one for one in series}


def kept_evidence(kept: SavedInformation) -> dict[str, AngleEvidence]:
    """What was kept, as sources of angles about its rotation."""
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
    """Sources and series of a fit about the rotation that came of it.

    error: (3,), by which the fit turned the rotation; gravity's series are about the new one as
    they come. bias: variance of the accelerometer's bias in gravity's sources.
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
    """Both as one, about the rotation of now; the prior ones with what changes between drives.

    That change is the same for all kinds of an angle, but is taken as each one's own here. It
    makes the sum a little too certain, by less than what the next start widens it by again.
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
    """The same in at most `MAX_SEGMENTS` rows: neighbours are summed, equally many in each."""
    if len(x) <= MAX_SEGMENTS:
        return x
    starts = np.arange(MAX_SEGMENTS) * len(x) // MAX_SEGMENTS
    out: Array = np.add.reduceat(x, starts)
    return out


def _rounded(x: Array) -> list[float]:
    return [float(f"{value:.{DIGITS}g}") for value in x.tolist()]


def saved_from(content: object) -> SavedInformation:
    """What `plain` gave; EstimateError where it makes no sense."""
    try:
        if not isinstance(content, Mapping) or not isinstance(content["without_speed"], bool):
            raise TypeError("not of our making")
        R = np.array(_numbers(content["rotation"], 9)).reshape(3, 3)
        if np.abs(orthonormalised(R) - R).max() > ROTATION_TOLERANCE or np.linalg.det(R) < 0.0:
            raise ValueError("no rotation")
        sources = {str(name): _source(str(name), p) for name, p in content["kinds"].items()}
    except (KeyError, TypeError, ValueError, AttributeError, np.linalg.LinAlgError) as error:
        raise EstimateError(f"kept evidence makes no sense ({error})") from None
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
