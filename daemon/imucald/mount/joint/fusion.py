"""Fuse all measurements of both sensors into one estimate of the unknowns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from imucald.core.arrays import Array
from imucald.core.samples import GRAVITY
from imucald.mount.joint.state import (
    CROSS,
    CROWN,
    EPS,
    FREE,
    PHI,
    UNKNOWNS,
    ZERO,
    Priors,
    WeightedPrior,
)


class LinearMeasurement(NamedTuple):
    """Linear measurements of the unknowns: rows (m, UNKNOWNS), values (m,), covariance (m, m)."""

    rows: Array
    values: Array
    covariance: Array


def joined(one: LinearMeasurement, other: LinearMeasurement, shared: float) -> LinearMeasurement:
    """Return two single measurements as one. shared: covariance of their errors."""
    noise = np.diag([one.covariance[0, 0], other.covariance[0, 0]])
    noise[0, 1] = noise[1, 0] = shared
    values = np.concatenate([one.values, other.values])
    return LinearMeasurement(np.vstack([one.rows, other.rows]), values, noise)


def fuse(
    hypotheses: Sequence[WeightedPrior], measured: Sequence[LinearMeasurement], taken: Array
) -> tuple[Array, Array, Array]:
    """Return the mean of the unknowns minus `taken`, the covariance of the unknowns, and the
    probability of each hypothesis.

    The mean is computed over all hypotheses, weighted by their probabilities after the
    measurements. taken: (UNKNOWNS,) part of the unknowns that the working axes already correct.
    """
    rows, values, noise = _stacked(measured, taken)
    found = [_fused(h, rows, values, noise) for h in hypotheses]
    log = np.array([f[2] for f in found]) + np.log([h.chance for h in hypotheses])
    share = np.exp(log - log.max())
    share /= share.sum()
    mean = np.einsum("k,ki->i", share, np.array([f[0] for f in found]))
    covariance = np.zeros((UNKNOWNS, UNKNOWNS))
    for part, (value, own, _) in zip(share, found, strict=True):
        off = value - mean
        covariance += part * (own + np.outer(off, off))
    return mean - taken, covariance, share


def contradiction(
    before: WeightedPrior, measured: Sequence[LinearMeasurement], taken: Array
) -> float:
    """Return the chi-square, with three degrees of freedom, of the rotation from the measurements
    against the rotation of the prior `before`.

    Both rotations depend on the same terms of the sensor. The rotation is therefore fitted without
    a prior. The result is compared with the rotation that `before` predicts for the fitted terms.
    """
    P, terms = before.covariance, np.arange(PHI.stop, UNKNOWNS)
    free = P.copy()
    free[PHI], free[:, PHI] = 0.0, 0.0
    free[PHI, PHI] = FREE**2 * np.eye(3)
    mean, covariance, _ = _fused(before._replace(covariance=free), *_stacked(measured, taken))
    answer = np.linalg.solve(P[np.ix_(terms, terms)], P[terms, PHI]).T
    against = np.concatenate([np.eye(3), -answer], axis=1)
    off = against @ (mean - before.mean)
    spread = against @ covariance @ against.T + P[PHI, PHI] - answer @ P[terms, PHI]
    return float(off @ np.linalg.solve(spread, off))


def any_sensor(priors: Priors, chance: float = 1.0) -> list[WeightedPrior]:
    """Return the priors of an unknown sensor, one prior for each size of the cross-axis errors."""
    made = []
    for cross, part in priors.cross_axis:
        std = np.full(UNKNOWNS, FREE)
        # The gain of one axis is a cross-axis term in rotated axes: over all rotations, its
        # variance is 1/5 of the gain's.
        std[CROSS] = np.hypot(cross, priors.gain / np.sqrt(5.0))
        std[ZERO], std[EPS] = priors.zero / GRAVITY, priors.gyro
        std[CROWN] = np.sqrt(priors.crown_variance)
        made.append(WeightedPrior(np.zeros(UNKNOWNS), np.diag(std**2), chance * part))
    return made


def _stacked(measured: Sequence[LinearMeasurement], taken: Array) -> tuple[Array, Array, Array]:
    """Return rows, values and covariance of all measurements together. The values are relative to
    the axes before any correction: `rows @ taken` is added.
    """
    rows = np.vstack([m.rows for m in measured])
    values = np.concatenate([m.values for m in measured]) + rows @ taken
    noise = np.zeros((len(values), len(values)))
    at = 0
    for m in measured:
        stop = at + len(m.values)
        noise[at:stop, at:stop] = m.covariance
        at = stop
    return rows, values, noise


def _fused(
    prior: WeightedPrior, rows: Array, values: Array, noise: Array
) -> tuple[Array, Array, float]:
    values = values - rows @ prior.mean
    spread = prior.covariance @ rows.T
    seen = rows @ spread + noise
    gain = np.linalg.solve(seen, spread.T).T
    likelihood = -0.5 * (values @ np.linalg.solve(seen, values) + np.linalg.slogdet(seen)[1])
    return prior.mean + gain @ values, prior.covariance - gain @ spread.T, float(likelihood)
