"""What a source says of an angle, road segment by road segment, and its fit."""

from __future__ import annotations

from functools import cache, cached_property

import numpy as np
from msgspec import Struct

from imucald.core.arrays import Array

_AXES = {"roll": 0, "pitch": 1, "yaw": 2}


@cache
def _axis_of(kind: str) -> int:
    return _AXES[kind.partition("_")[0]]


class AngleFit(Struct, frozen=True):
    """The fit of an angle together with its source's nuisance, segment by segment.

    left (G,): scores of the angle that the fit leaves over. rows (G, 1 + k): information of the
    angle, and what it shares with the nuisance. inverse (1 + k, 1 + k): covariance of both, from
    all segments and priors. value: the angle [rad].
    """

    left: Array
    rows: Array
    inverse: Array
    value: float


class ScoreSeries(Struct, frozen=True, dict=True):
    """Evidence about one angle from one source, segment by segment: scores and informations (G,).

    kind: the source, of those in `shift.UNEVEN_STD`. fit: where the angle was fitted together with
    nuisance; else each segment speaks of it alone.
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
        """This series behind earlier segments (E,), which speak of the angle alone."""
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
        """The fit; without nuisance the mean. None without any information."""
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
