"""Compare segments of a drive with the segments from which a model file was made.

For several kinds of numbers, a model file contains the median over the segments of its own drives
and the scatter between segments. A `Family` is one kind; it has one `FamilyRow` for each number.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import msgspec
import numpy as np
from scipy.stats import t as student

from imucald.core.arrays import Array
from imucald.diagnosis.fit.chance import Answer, chance_of_large
from imucald.model.leaves import Bands, Leaves
from imucald.model.model import VehicleModel

LEAST_SEGMENTS = 10
ROAD_CLASS = 2.0
"""Ratio of the rms values of neighbouring road classes (ISO 8608: the spectral densities differ by
a factor of 4)."""
MOST_CORRELATED = 0.6
"""Largest correlation of neighbouring segments that is assumed. With this correlation, four
segments count as one."""
MEDIAN = float(np.sqrt(0.5 * np.pi))
"""Ratio of the standard deviation of the median to that of the mean, for normal variables."""
LEAST_RMS = 1e-9
Left = dict[str, tuple[Array, Array]]
"""By name: mean speed (B,) of each segment, and the numbers (B, 6) of each segment."""


@dataclass(frozen=True)
class FamilyRow:
    """Comparison of one number of a family with the number of the model file."""

    limit: float
    """Largest difference of the logarithms between two correct drives."""
    words: Callable[[float, float], str]
    """Function that makes the reported text. The arguments of this function are the value that half
    of the segments reach, and the logarithm of the ratio of this value to the value of the model
    file."""
    start: float = 0.0
    """Difference of the logarithms beyond which the chance is computed."""
    either_way: bool = False
    """True if smaller numbers are tested too."""
    in_times: bool = True
    """If True, the reported size is the ratio divided by the limit's ratio. If False, the reported
    size is the difference divided by the limit."""


@dataclass(frozen=True)
class Family:
    """Numbers of segments that a model file contains for its own drives."""

    row: Callable[[str, int], FamilyRow | None]
    """Function that returns the row for the name of an entry and the index of its number; None: not
    tested."""
    least: int = LEAST_SEGMENTS
    """Smallest number of segments of an entry, and of a drive that is compared with the entry."""

    def answers(self, left: Mapping[float, Left], stated: VehicleModel) -> Iterator[Answer]:
        """Yield one answer for each number. left: numbers of the segments, by segment length
        [s]."""
        for seconds, own in left.items():
            for name, x, file in in_both(own, stated.leaves, seconds, self.least, self.least):
                yield from self.of_entry(name, x, file)

    def of_entry(self, name: str, x: Array, file: Leaves) -> Iterator[Answer]:
        """Yield the answers for one entry. x: (B, 6) numbers of the segments."""
        logs, more, se, free = beside_file(x, file)
        for i in range(x.shape[1]):
            row = self.row(name, i)
            if row is None or free[i] < 1.0:
                continue
            far = float(abs(more[i]) if row.either_way else more[i])
            sides = 2.0 if row.either_way else 1.0
            p = min(sides * float(student.sf((far - row.start) / se[i], free[i])), 1.0)
            # A chance computed beyond the limit is already the chance of looking large.
            is_sharp = row.start == 0.0
            yield Answer(
                name.split()[2] if " " in name else name, far, row.limit, p,
                row.words(float(np.exp(np.median(logs[:, i]))), float(more[i])),
                sure=float(far - se[i]),
                shown=float(np.exp(far - row.limit)) if row.in_times else far / row.limit,
                rare=chance_of_large(row.limit, float(se[i]), float(free[i])) if is_sharp else 1.0,
            )  # fmt: skip

    def written(self, model: VehicleModel, left: Mapping[float, Left]) -> VehicleModel:
        """Return the model file with entries for these segments, in addition to its previous
        entries."""
        for seconds, own in left.items():
            model = with_entries(model, leaves_of(own, seconds, self.least))
        return model


def joined(parts: Mapping[str, list[tuple[Array, Array]]]) -> Left:
    """Join speeds and numbers of several drives."""
    return {
        name: (np.concatenate([v for v, _ in p]), np.concatenate([x for _, x in p]))
        for name, p in parts.items()
    }


def leaves_of(left: Left, segment_s: float, least: int = LEAST_SEGMENTS) -> dict[str, Leaves]:
    """Return entries of a model file for segments of a length [s]. Quantities with too few segments
    have no entry."""
    made = {}
    for name, (v, rms) in left.items():
        if len(v) >= least:
            low, high = np.quantile(v, (0.05, 0.95))
            logs = np.log(np.maximum(rms, LEAST_RMS))
            middle, spread = np.exp(np.median(logs, axis=0)), logs.std(axis=0, ddof=1)
            speeds = (round(float(low), 2), round(float(high), 2))
            made[name] = Leaves(len(v), segment_s, speeds, six(middle), six(spread))
    return made


def six(x: Array) -> Bands:
    """Convert an array (6,) to the tuple that an entry of the file contains."""
    a, b, c, d, e, f = (short(each) for each in x)
    return a, b, c, d, e, f


def short(x: float) -> float:
    """Round a number to four significant digits."""
    return float(f"{x:.4g}")


def with_entries(model: VehicleModel, made: Mapping[str, Leaves]) -> VehicleModel:
    """Return the model file with these entries, in addition to its previous entries."""
    return model.with_changes({"leaves": msgspec.to_builtins({**model.leaves, **made})})


def in_both(
    left: Left,
    stated: Mapping[str, Leaves],
    segment_s: float,
    least: int = LEAST_SEGMENTS,
    known: int = LEAST_SEGMENTS,
) -> Iterator[tuple[str, Array, Leaves]]:
    """Yield name, numbers (B, 6) and file entry for each entry with the same segment length. At
    least `least` segments must be within the speed range of the file entry. The file entry must
    have at least `known` segments."""
    for name, (v, x) in left.items():
        file = stated.get(name)
        if file is None or file.segment_s != segment_s:
            continue
        inside = (v >= file.speeds_mps[0]) & (v <= file.speeds_mps[1])
        if inside.sum() >= least and file.segments >= known:
            yield name, x[inside], file


def beside_file(rms: Array, file: Leaves) -> tuple[Array, Array, Array, Array]:
    """Compare the residuals of the segments with a file entry.

    Returns the logarithms (B, 6) of the residuals, the excess (6,) of their medians over the file
    entry, the standard deviations (6,) of the excess, and the degrees of freedom (6,). A road lasts
    over several segments, so neighbouring segments are correlated and count as fewer independent
    segments.
    """
    logs = np.log(np.maximum(rms, LEAST_RMS))
    one = _count_as_one(logs)
    own, known = len(logs) / one, file.segments / one
    more = np.median(logs, axis=0) - np.log(np.maximum(file.rms, LEAST_RMS))
    variance = logs.var(axis=0, ddof=1) / own + np.square(file.spread) / known
    return logs, more, MEDIAN * np.sqrt(np.maximum(variance, 1e-12)), own + known - 2.0


def _count_as_one(x: Array) -> Array:
    """Return the number (6,) of segments of x (B, 6) that count as one independent segment: (1 +
    r)/(1 - r). r is the correlation of neighbours (first-order autoregression; Bayley and
    Hammersley 1946). The value used is the observed correlation plus one standard deviation,
    1/sqrt(B)."""
    x = x - x.mean(axis=0)
    r = np.sum(x[1:] * x[:-1], axis=0) / np.maximum(np.sum(x * x, axis=0), 1e-300)
    r = np.clip(r + len(x) ** -0.5, 0.0, MOST_CORRELATED)
    return np.asarray((1.0 + r) / (1.0 - r))
