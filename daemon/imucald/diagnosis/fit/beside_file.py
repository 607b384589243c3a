"""Segments of a drive next to those that a model file was made of.

A model file carries what half of the segments of its own drives show, number by number, and how far
segments differ. Here such an entry is made, written and compared, whatever its numbers are: a
family of entries is a row for each of its numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import msgspec
import numpy as np
from scipy.stats import t as student

from imucald.core.arrays import Array
from imucald.diagnosis.fit.chance import Question, chance_of_large
from imucald.diagnosis.result import Structure
from imucald.model.leaves import Bands, Leaves
from imucald.model.model import VehicleModel

LEAST_SEGMENTS = 10
ROAD_CLASS = 2.0
"""rms of a road over that of the next class (ISO 8608: spectral densities are 4 apart)."""
MOST_CORRELATED = 0.6
"""Correlation of neighbours from which on no more is taken for it: four segments count as one."""
MEDIAN = float(np.sqrt(0.5 * np.pi))
"""Deviation of the median over that of the mean, of normal numbers."""
LEAST_RMS = 1e-9
INSIDE = (0.05, 0.95)
Left = dict[str, tuple[Array, Array]]
"""By name: mean speed (B,) of each segment, and its numbers (B, 6)."""


@dataclass(frozen=True)
class FamilyRow:
    """One number of a family, next to the file's."""

    limit: float
    """By how much the logarithms of two correct drives may differ."""
    words: Callable[[float, float], str]
    """What is reported: of what half of the segments show and more, and of the logarithm of its
    ratio to the file's."""
    start: float = 0.0
    """Difference from which chance is counted."""
    either_way: bool = False
    """Whether less is asked as well."""
    in_times: bool = True
    """Whether the size is a ratio over that of the limit, or the difference over the limit."""


@dataclass(frozen=True)
class Family:
    """Numbers of segments that a model file states of its own drives."""

    kind: str
    row: Callable[[str, int], FamilyRow | None]
    """By name of an entry and number; None: not asked."""
    least: int = LEAST_SEGMENTS
    """Segments of an entry, and of a drive that is held against it."""

    def asked(self, left: Mapping[float, Left], stated: VehicleModel) -> list[Question]:
        """One question a number. left: by length of a segment [s]."""
        return [
            question
            for seconds, own in left.items()
            for name, x, file in in_both(own, stated.leaves, seconds, self.least, self.least)
            for question in self.questions(name, x, file)
        ]

    def questions(self, name: str, x: Array, file: Leaves) -> list[Question]:
        """Of one entry. x: (B, 6)."""
        logs, more, se, free = beside_file(x, file)
        made = []
        for i in range(x.shape[1]):
            row = self.row(name, i)
            if row is None or free[i] < 1.0:
                continue
            far = float(abs(more[i]) if row.either_way else more[i])
            sides = 2.0 if row.either_way else 1.0
            p = min(sides * float(student.sf((far - row.start) / se[i], free[i])), 1.0)
            size = float(np.exp(far - row.limit)) if row.in_times else far / row.limit
            text = row.words(float(np.exp(np.median(logs[:, i]))), float(more[i]))
            structure = Structure(name.split()[2] if " " in name else name, self.kind, size, text)
            # Chance that starts from the limit is that of looking large.
            is_sharp = row.start == 0.0
            rare = chance_of_large(row.limit, float(se[i]), float(free[i])) if is_sharp else 1.0
            made.append(Question(p, bool(far - se[i] > row.limit), structure, rare))
        return made

    def written(self, model: VehicleModel, left: Mapping[float, Left]) -> VehicleModel:
        """The model file with what these segments show, besides entries that it had."""
        for seconds, own in left.items():
            model = with_entries(model, leaves_of(own, seconds, self.least))
        return model


def joined(parts: Mapping[str, list[tuple[Array, Array]]]) -> Left:
    """Speeds and numbers of drives, one after another."""
    return {
        name: (np.concatenate([v for v, _ in p]), np.concatenate([x for _, x in p]))
        for name, p in parts.items()
    }


def leaves_of(left: Left, segment_s: float, least: int = LEAST_SEGMENTS) -> dict[str, Leaves]:
    """What a model file carries of segments of a length [s], where there are so many at least."""
    made = {}
    for name, (v, rms) in left.items():
        if len(v) >= least:
            low, high = np.quantile(v, INSIDE)
            logs = np.log(np.maximum(rms, LEAST_RMS))
            middle, spread = np.exp(np.median(logs, axis=0)), logs.std(axis=0, ddof=1)
            speeds = (round(float(low), 2), round(float(high), 2))
            made[name] = Leaves(len(v), segment_s, speeds, six(middle), six(spread))
    return made


def six(x: Array) -> Bands:
    """The numbers (6,) of a section of the file."""
    a, b, c, d, e, f = (short(each) for each in x)
    return a, b, c, d, e, f


def short(x: float) -> float:
    """Four digits of a number."""
    return float(f"{x:.4g}")


def with_entries(model: VehicleModel, made: Mapping[str, Leaves]) -> VehicleModel:
    """The model file with these entries, besides others that it had."""
    return model.with_changes({"leaves": msgspec.to_builtins({**model.leaves, **made})})


def in_both(
    left: Left,
    stated: Mapping[str, Leaves],
    segment_s: float,
    least: int = LEAST_SEGMENTS,
    known: int = LEAST_SEGMENTS,
) -> Iterator[tuple[str, Array, Leaves]]:
    """Name, numbers (B, 6) and the file's entry, where at least so many segments of the same length
    were driven at the speeds of the file's, and the file knows so many."""
    for name, (v, x) in left.items():
        file = stated.get(name)
        if file is None or file.segment_s != segment_s:
            continue
        inside = (v >= file.speeds_mps[0]) & (v <= file.speeds_mps[1])
        if inside.sum() >= least and file.segments >= known:
            yield name, x[inside], file


def beside_file(rms: Array, file: Leaves) -> tuple[Array, Array, Array, Array]:
    """Logarithms (B, 6) of what segments leave, by how much their medians (6,) exceed the file's,
    its deviations, and degrees of freedom (6,).

    Roads last over neighbours: segments count for as many as correlated ones do.
    """
    logs = np.log(np.maximum(rms, LEAST_RMS))
    one = _count_as_one(logs)
    own, known = len(logs) / one, file.segments / one
    more = np.median(logs, axis=0) - np.log(np.maximum(file.rms, LEAST_RMS))
    variance = logs.var(axis=0, ddof=1) / own + np.square(file.spread) / known
    return logs, more, MEDIAN * np.sqrt(np.maximum(variance, 1e-12)), own + known - 2.0


def _count_as_one(x: Array) -> Array:
    """(6,) how many segments of x (B, 6) count as one, (1 + r)/(1 - r) where neighbours have the
    correlation r (first-order autoregression; Bayley and Hammersley 1946): the one that they show
    and a deviation of it, 1/sqrt(B), more."""
    x = x - x.mean(axis=0)
    r = np.sum(x[1:] * x[:-1], axis=0) / np.maximum(np.sum(x * x, axis=0), 1e-300)
    r = np.clip(r + len(x) ** -0.5, 0.0, MOST_CORRELATED)
    return np.asarray((1.0 + r) / (1.0 - r))
