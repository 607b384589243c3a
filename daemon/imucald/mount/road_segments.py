"""Compute values with variances from scores and informations of road segments.

Each regression is a least-squares fit with priors on the nuisance. The variance of the angle is a
mix of the model's variance, from the noise levels, and of the spread of the scores between road
segments (sandwich; White, Econometrica 48, 1980), with the covariance of neighbours.

`ScoreSeries` holds the evidence of a source about an angle per road segment, `AngleFit` its fit.
"""

from __future__ import annotations

from functools import cache, cached_property

import numpy as np
from msgspec import Struct

from imucald.core.arrays import Array, summed_in_order
from imucald.mount.evidence_rows import MAX_REGRESSORS, ROWS, WITHOUT_SPEED

_AXES = {"roll": 0, "pitch": 1, "yaw": 2}


@cache
def _axis_of(kind: str) -> int:
    return _AXES[kind.partition("_")[0]]


class AngleFit(Struct, frozen=True):
    """The fit of an angle together with its source's nuisance, segment by segment.

    left (G,): residual scores of the angle. rows (G, 1 + k): information of the angle, and its
    cross terms with the nuisance. inverse (1 + k, 1 + k): covariance of both, from all segments and
    priors. value: the angle [rad].
    """

    left: Array
    rows: Array
    inverse: Array
    value: float


class ScoreSeries(Struct, frozen=True, dict=True):
    """Evidence about one angle from one source, segment by segment: scores and informations (G,).

    kind: the source, as named in `shift.UNEVEN_STD`. fit: the fit, if the angle was fitted together
    with nuisance; otherwise each segment shows the angle alone.
    """

    kind: str
    score: Array
    information: Array
    fit: AngleFit | None = None

    @property
    def axis(self) -> int:
        """The angle it is about: 0 roll, 1 pitch, 2 yaw."""
        return _axis_of(self.kind)

    def behind(self, score: Array, information: Array) -> ScoreSeries:
        """Return this series after earlier segments (E,), which show only the angle."""
        both = np.concatenate([score, self.score]), np.concatenate([information, self.information])
        fit = self.fit
        if fit is None:
            return ScoreSeries(self.kind, *both)
        known = float(information.sum())
        column = fit.inverse[:, 0]
        inverse = fit.inverse - np.outer(column, column) * (known / (1.0 + known * column[0]))
        moved = inverse[:, 0] * (float(score.sum()) - known * fit.value)
        value = fit.value + float(moved[0])
        left = np.concatenate([score - information * value, fit.left - fit.rows @ moved])
        rows = np.zeros((len(left), fit.rows.shape[1]))
        rows[: len(score), 0] = information
        rows[len(score) :] = fit.rows
        return ScoreSeries(self.kind, *both, AngleFit(left, rows, inverse, value))

    def fitted(self) -> AngleFit | None:
        """Return the fit; without nuisance, the mean. None without any information."""
        return self._fitted

    @cached_property
    def _fitted(self) -> AngleFit | None:
        if self.fit is not None:
            return self.fit
        n, total = self.information, float(self.information.sum())
        if total <= 0.0:
            return None
        mean = float(self.score.sum()) / total
        return AngleFit(self.score - n * mean, n[:, None], np.array([[1.0 / total]]), mean)


MODEL_GROUPS = 6.0
"""Weight of the model's variance in the sandwich, in road segments."""
MODEL_SHARE = np.array([1.5, 1.5, 1.15])
"""Factor on the model's variance for roll, pitch and yaw, because noise is usually correlated."""
WITHOUT_SPEED_SHARE = 3.0
"""Factor on the variances of rotation axes without speed, because A r is not known then."""
FEWEST = 3.0
"""Smallest number of segments from which a spread is known."""
MIN_INFORMATION = 50.0
"""Smallest information of a source [1/rad^2]: 8 deg."""


class AngleEvidence(Struct):
    """Evidence of one source about one angle: value [rad], variance, number of road segments.

    road: part of the variance from the mean slope or lean of the road driven.
    """

    value: float
    variance: float
    groups: float
    road: float = 0.0


def _priors() -> Array:
    """Return the information of the nuisance priors (rows, most, most); unused places are held at
    zero.
    """
    out = np.zeros((len(ROWS), MAX_REGRESSORS, MAX_REGRESSORS))
    for i, row in enumerate(ROWS):
        held = [1.0] * (MAX_REGRESSORS - len(row.regressors))
        out[i] = np.diag([0.0, *(1.0 / x**2 for x in row.prior_std), *held])
    return out


_PRIORS = _priors()
_MODEL_SHARES = MODEL_SHARE[[row.axis for row in ROWS]]
_FEW = np.array([row.few for row in ROWS])


def fit_regressions(
    score: Array, normal: Array, without_speed: bool
) -> tuple[dict[str, AngleEvidence], list[ScoreSeries]]:
    """Fit each regression; return its evidence about the angle, and its series for the shift test.

    score: (rows, groups, regressors), normal: (rows, groups, regressors, regressors).
    """
    total = normal.sum(axis=1)
    use = [
        i
        for i, size in enumerate(total[:, 0, 0].tolist())
        if size >= MIN_INFORMATION and (not without_speed or i in WITHOUT_SPEED)
    ]
    if not use:
        return {}, []
    total = total[use]
    fit, inverse = _fitted(score, normal, use, total, _PRIORS[use])
    model, sums = inverse[:, 0, 0], total[:, 0, 0]
    groups = sums * sums / np.maximum(fit.squares, 1e-12)
    variances = _variances(fit.spread, fit.beside, model * _MODEL_SHARES[use], groups)
    variances *= 1.0 + _FEW[use] / (groups + 3.0)
    sources: dict[str, AngleEvidence] = {}
    series: list[ScoreSeries] = []
    for k, i in enumerate(use):
        row = ROWS[i]
        variance = row.share * float(variances[k])
        if without_speed and row.name.endswith("axis"):
            variance *= WITHOUT_SPEED_SHARE
        value = float(fit.value[k, 0])
        sources[row.name] = AngleEvidence(value, variance, float(groups[k]))
        angle = AngleFit(fit.left[k], normal[i, :, 0, :], inverse[k], value)
        series.append(ScoreSeries(row.name, fit.flow[k], fit.own[k], angle))
    return sources, series


class _Fit(Struct, frozen=True):
    """Fits of U rows over G segments.

    value: (U, regressors). left: (U, G) residual scores of the angle. own: information of each
    segment about it, without the nuisance. flow: its score. spread, beside: (U,) sums of the
    squares of the shares in the value, and of the products of neighbouring shares. squares: sums of
    squared information.
    """

    value: Array
    left: Array
    own: Array
    flow: Array
    spread: Array
    beside: Array
    squares: Array


def _inverses(matrices: Array) -> Array:
    """Return the inverses of symmetric positive definite matrices (n, k, k), which need no search
    for pivots.
    """
    out = matrices.copy()
    k = out.shape[1]
    others = [np.array([j for j in range(k) if j != i]) for i in range(k)]
    for i, beside in enumerate(others):
        pivot = 1.0 / out[:, i, i]
        row, column = out[:, i, beside] * pivot[:, None], out[:, beside, i]
        out[:, beside[:, None], beside] -= column[:, :, None] * row[:, None]
        out[:, i, beside], out[:, beside, i] = row, -(column * pivot[:, None])
        out[:, i, i] = pivot
    return out


def _fitted(
    score: Array, normal: Array, use: list[int], total: Array, priors: Array
) -> tuple[_Fit, Array]:
    """Return the fit, and the inverses of the informations.

    score, normal: of all rows; the other arguments are of the rows in use.
    """
    rows = len(use)
    inverse = _inverses(total + priors)
    if rows < len(ROWS):
        score, normal = score[use], normal[use]
    value = summed_in_order(inverse * score.sum(axis=1)[:, None])
    rest = score - summed_in_order(normal * value[:, None, None])
    u = summed_in_order(rest * inverse[:, None, 0])
    model, known = inverse[:, 0, 0], normal[:, :, 0, 0]
    own = known * (1.0 / (total[:, 0, 0] * model))[:, None]  # what the nuisance leaves
    flow = u / model[:, None] + own * value[:, :1]
    pairs = (u, u), (u[:, 1:], u[:, :-1]), (known, known)
    spread, beside, squares = ((x * y).sum(axis=1) for x, y in pairs)
    return _Fit(value, rest[:, :, 0], own, flow, spread, beside, squares), inverse


def apart(one: ScoreSeries, other: ScoreSeries) -> AngleEvidence | None:
    """Return the difference between the angles of two sources over the same segments; None without
    fits.

    Noise that is in both, such as that of the road, cancels. The variance therefore comes from the
    segments' shares in the difference itself. For n segments it is Student's, n / (n - 2) times
    that.
    """
    if one.fit is None or other.fit is None:
        return None
    u = _shares(one, one.fit) - _shares(other, other.fit)
    known = np.minimum(one.information, other.information)
    groups = float(known.sum() ** 2 / max(float((known * known).sum()), 1e-12))
    if groups < FEWEST:
        return None
    spread, beside = float(u @ u), float(u[1:] @ u[:-1])
    variance = max(spread + 2.0 * beside, spread) * groups / (groups - 2.0)
    return AngleEvidence(one.fit.value - other.fit.value, variance, groups)


def _shares(of: ScoreSeries, fit: AngleFit) -> Array:
    """Return the part of each segment in the error of a fitted angle (G,) [rad]."""
    shares: Array = fit.inverse[0, 0] * (of.score - of.information * fit.value)
    return shares


def _variances(spread: Array, beside: Array, model: Array, groups: Array) -> Array:
    """Return variances from the groups' shares in the values and from the model's variance; see
    `_Fit`.
    """
    spread = np.maximum(spread + 2.0 * beside, 0.6 * spread)
    out: Array = (MODEL_GROUPS * model + groups * spread) / (MODEL_GROUPS + groups)
    return out
