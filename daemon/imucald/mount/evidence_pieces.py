"""From sums of scores and informations, piece of road by piece, to values with their variances.

Per regression a least-squares fit with priors on the nuisance; the variance of the angle is a mix
of the model's (what the noise levels say) and of the spread of the scores from piece of road to
piece of road (sandwich; White, Econometrica 48, 1980), neighbours' covariance included.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucald.mount.evidence_rows import ROWS, WITHOUT_SPEED
from imucald.mount.shift import Flow

Array = NDArray[np.float64]

MODEL_GROUPS = 6.0
"""The model's variance counts like that many pieces of road in the sandwich."""
MODEL_SHARE = 1.5
"""The model's variance is taken that much larger: correlated noise is the rule."""

FEW_GROUPS = 7.0
"""Few pieces of road hide their own spread: the variance grows by this over their number."""
AXIS_SHARE = 1.6
"""Roll and rotation axes of a drive share roads and bends: their variance is so much larger."""
WITHOUT_SPEED_SHARE = 3.0
"""Without speed A r is not known: variances of rotation axes are so much larger."""
LEAST_INFORMATION = 50.0
"""Less than this [1/rad^2], 8 deg, is not worth a piece."""


@dataclass
class Piece:
    """One piece of evidence about one angle: value [rad], variance, pieces of road in it."""

    value: float
    variance: float
    groups: float


def pieces_of(
    score: Array, normal: Array, without_speed: bool
) -> tuple[dict[str, Piece], list[Flow]]:
    """Fit each regression; return its piece of evidence, and its flow for the shift test.

    score: (rows, groups, regressors), normal: (rows, groups, regressors, regressors).
    """
    pieces: dict[str, Piece] = {}
    flows: list[Flow] = []
    for i, row in enumerate(ROWS):
        if without_speed and i not in WITHOUT_SPEED:
            continue
        m = len(row.regressors)
        s, n = score[i, :, :m], normal[i, :, :m, :m]
        total = n.sum(axis=0)
        if total[0, 0] < LEAST_INFORMATION:
            continue
        prior = np.array([0.0, *(1.0 / x**2 for x in row.prior_std)])
        inverse = np.linalg.inv(total + np.diag(prior))
        value = inverse @ s.sum(axis=0)
        u = (s - n @ value) @ inverse[0]
        each = n[:, 0, 0]
        share = 1.0 / (total[0, 0] * inverse[0, 0])  # what the nuisance leaves
        own = each * share
        flows.append(Flow(row.axis, u / inverse[0, 0] + own * value[0], own))
        groups = float(total[0, 0] ** 2 / max(float(each @ each), 1e-12))
        variance = _variance(u, float(inverse[0, 0]), groups)
        if row.axis == 0 or row.name.endswith("axis"):
            variance *= AXIS_SHARE * (WITHOUT_SPEED_SHARE if without_speed else 1.0)
        pieces[row.name] = Piece(float(value[0]), variance, groups)
    return pieces, flows


def _variance(u: Array, model: float, groups: float) -> float:
    """Variance from the groups' shares u (groups,) in the value, and from the model's."""
    spread = float(u @ u)
    if len(u) > 1:
        spread = max(spread + 2.0 * float(u[1:] @ u[:-1]), 0.6 * spread)
    mixed = (MODEL_GROUPS * model * MODEL_SHARE + groups * spread) / (MODEL_GROUPS + groups)
    return mixed * (1.0 + FEW_GROUPS / (groups + 3.0))
