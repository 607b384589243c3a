"""Fuse sources of evidence about the three angles into one rotation with a covariance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.mount.road_segments import AngleEvidence

Array = NDArray[np.float64]

MAX_WIDENED = 25.0
"""Sources of equal weight that disagree widen the variance by chi^2 per degree of freedom (Birge),
at most this; where one carries nearly all, another's dissent says more of that other."""
AXES = ("roll", "pitch", "yaw")


class CommonError(Struct, frozen=True):
    """An error that several sources share: its standard deviation [rad] and each one's sign."""

    std: float
    signs: Mapping[str, float]


class Fused(Struct, frozen=True):
    """e (3,) [rad], its variances (3,), and which share of each angle each source carried."""

    error: Array
    variance: Array
    shares: dict[str, dict[str, float]]


class CommonCovariance:
    """Covariance that sources have with one another (and with themselves) from shared errors."""

    def __init__(self, shared: Sequence[CommonError], scaled: Sequence[CommonError] = ()) -> None:
        """scaled: errors as large as `scale` says (1 at first), which may change."""
        self._pairs = _pairs(shared)
        self._scaled = _pairs(scaled)
        self._of_names: dict[tuple[str, ...], tuple[Array, Array]] = {}
        self.scale2 = 1.0

    def errors(self, names: Sequence[str]) -> tuple[Array, Array]:
        """Covariances of sources from shared errors, and from scaled ones at scale 1."""
        key = tuple(names)
        found = self._of_names.get(key)
        if found is None:  # few sets of names come
            shared, scaled = (
                np.array([[pairs.get((a, b), 0.0) for b in names] for a in names])
                for pairs in (self._pairs, self._scaled)
            )
            found = self._of_names[key] = shared, scaled
        return found

    def covariance(self, sources: Mapping[str, AngleEvidence], names: Sequence[str]) -> Array:
        """Covariance of the sources of those names, their own variances included."""
        shared, scaled = self.errors(names)
        known = shared.copy()
        known.flat[:: len(names) + 1] += [sources[name].variance for name in names]
        return known + self.scale2 * scaled if self._scaled else known


def _pairs(shared: Sequence[CommonError]) -> dict[tuple[str, str], float]:
    found: dict[tuple[str, str], float] = {}
    for s in shared:
        for one, sign in s.signs.items():
            for other, other_sign in s.signs.items():
                sofar = found.get((one, other), 0.0)
                found[one, other] = sofar + s.std * s.std * sign * other_sign
    return found


class _Layout(Struct, frozen=True):
    """Where the sources of all angles stand in stacked matrices; an angle of one is left out.

    An angle with fewer sources than another gets some that tell nothing (is_there 0).
    """

    names: list[str]
    angle: list[int]
    place: list[int]
    certain: Array  # (angles, n, n), without the sources' own variances
    scaled: Array
    is_there: Array  # (angles, 1, n)


class ProbableScale:
    """Mean square of the scale of scaled errors, from how far sources contradict one another.

    candidates: scales and their prior probabilities. Each is weighed by the likelihood of the
    differences between the sources of an angle (of which the angle itself is free; restricted
    maximum likelihood, Patterson and Thompson, Biometrika 58, 1971), over all angles.
    uneven: what sources differ by for other reasons [rad].
    """

    def __init__(
        self,
        sharing: CommonCovariance,
        candidates: Sequence[tuple[float, float]],
        uneven: Mapping[str, float],
    ) -> None:
        scales, priors = np.array(candidates).T
        self._squares, self._log = scales * scales, np.log(priors)
        self._sharing, self._uneven = sharing, uneven
        self._layouts: dict[tuple[str, ...], _Layout] = {}

    def squared(self, sources: Mapping[str, AngleEvidence]) -> float:
        """The mean square of the scale by these sources."""
        keys = tuple(sources)
        layout = self._layouts.get(keys)
        if layout is None:
            layout = self._layouts[keys] = self._layout(keys)
        known, is_there = layout.certain.copy(), layout.is_there
        values = np.zeros(is_there.shape)
        found = [sources[name] for name in layout.names]
        known[layout.angle, layout.place, layout.place] += [one.variance for one in found]
        values[layout.angle, 0, layout.place] = [one.value for one in found]
        V = known[:, None] + self._squares[:, None, None] * layout.scaled[:, None]
        inverse = np.linalg.inv(V)
        column = (inverse * is_there[:, :, None]).sum(axis=3) * is_there
        total = column.sum(axis=2)
        left = (values - ((column * values).sum(axis=2) / total)[:, :, None]) * is_there
        misfit = ((inverse @ left[..., None])[..., 0] * left).sum(axis=2)
        log = self._log - 0.5 * (misfit + np.linalg.slogdet(V)[1] + np.log(total)).sum(axis=0)
        weight = np.exp(log - log.max())
        return float(weight @ self._squares / weight.sum())

    def _layout(self, names: Sequence[str]) -> _Layout:
        groups = [[name for name in names if name.startswith(axis)] for axis in AXES]
        groups = [group for group in groups if len(group) > 1]
        size = max(map(len, groups), default=0)
        certain, scaled = np.zeros((2, len(groups), size, size))
        is_there = np.zeros((len(groups), 1, size))
        for i, group in enumerate(groups):
            n = len(group)
            certain[i] = np.eye(size)
            certain[i, :n, :n], scaled[i, :n, :n] = self._sharing.errors(group)
            certain[i, range(n), range(n)] += [self._uneven.get(name, 0.0) ** 2 for name in group]
            is_there[i, 0, :n] = 1.0
        return _Layout(
            [name for group in groups for name in group],
            [i for i, group in enumerate(groups) for _ in group],
            [place for group in groups for place in range(len(group))],
            certain,
            scaled,
            is_there,
        )


def fuse(
    sources: Mapping[str, AngleEvidence],
    sharing: CommonCovariance,
    base: CommonCovariance | None = None,
) -> Fused:
    """Best linear unbiased mean per angle; a source's name begins with its angle.

    The weights are V^-1 1 / (1' V^-1 1), V being the sources' variances plus what they share; a
    negative weight is not taken. base: what the weights are made of, where `sharing` holds errors
    that are only probable: these widen the interval and move nothing.
    """
    error, variance = np.zeros(3), np.full(3, np.inf)
    shares: dict[str, dict[str, float]] = {}
    for i, axis in enumerate(AXES):
        names = [name for name in sources if name.startswith(axis)]
        if not names:
            continue
        V = sharing.covariance(sources, names)
        certain = V if base is None else base.covariance(sources, names)
        inverse, even = np.linalg.inv(np.array([V, certain]))
        weight = np.maximum(even.sum(axis=1), 0.0)
        weight /= weight.sum()
        values = np.array([sources[name].value for name in names])
        error[i] = weight @ values
        left = values - error[i]
        free = max(len(names) - 1, 1)
        disagreement = min(max(float(left @ inverse @ left) / free, 1.0), MAX_WIDENED)
        evenness = len(names) / free * (1.0 - float(weight @ weight))
        variance[i] = float(weight @ V @ weight) * (1.0 + (disagreement - 1.0) * evenness)
        shares[axis] = dict(zip(names, weight.tolist(), strict=True))
    return Fused(error, variance, shares)
