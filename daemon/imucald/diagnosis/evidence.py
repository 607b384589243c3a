"""Bayesian evidence of sets of causes from linearised normal equations.

Every parameter has a Gaussian prior about the model file's value: narrow (its tolerance) unless
its cause is in the set, then wide. With information A, score g at the point of linearisation and
prior mean m relative to it, M = A + L, h = g + L m:

    ln p = -1/2 (chi^2 + m' L m - h' M^-1 h) - 1/2 ln det M + 1/2 ln det L

(MacKay, Information Theory, Inference, and Learning Algorithms, ch. 28). What two causes can
explain alike is shared between them without any list of look-alikes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from imucald.diagnosis.cause import Parameter
from imucald.diagnosis.grid import Array
from imucald.diagnosis.spectra import Normal

HELD = 1e-5
"""Factor on the tolerance of what is held."""
LENIENCE = 0.9
"""A model file may be wrong by its tolerance; the prior is wider, since physics is never whole."""


class Fit:
    """Solution for one set: parameters x (P,) relative to the point of linearisation."""

    def __init__(self, log_evidence: float, x: Array, factor: tuple[Array, bool], scale: Array):
        self.log_evidence, self.x = log_evidence, x
        self._factor, self._scale = factor, scale

    @property
    def covariance(self) -> Array:
        """(P, P), of the parameters."""
        inverse: Array = cho_solve(self._factor, np.eye(len(self.x)))
        return np.asarray(inverse * np.outer(self._scale, self._scale))


class Evidence:
    """Evidence of sets of parameters around one point of linearisation.

    shift: (P,) the point minus the model file's values.
    """

    def __init__(self, parameters: Sequence[Parameter], normal: Normal, shift: Array) -> None:
        self.keys = [p.key for p in parameters]
        self._index = {key: i for i, key in enumerate(self.keys)}
        self._tolerance = np.array([LENIENCE * p.tolerance for p in parameters])
        self._wide = np.array([p.wide for p in parameters])
        self.normal = normal
        self.A, self.g, self.square = normal.total()
        self.shift = shift

    def precision(self, active: Iterable[str], fixed: Iterable[str] = ()) -> Array:
        """Prior precision (P,) with the keys of the set wide, others held at the file's values."""
        std = self._tolerance.copy()
        index = [self._index[key] for key in active]
        std[index] = self._wide[index]
        std[[self._index[key] for key in fixed]] *= HELD
        return std**-2.0

    def fit(
        self,
        active: Iterable[str],
        blocks: Array | None = None,
        temper: float = 1.0,
        fixed: Iterable[str] = (),
    ) -> Fit:
        """Evidence and solution for a set of keys.

        blocks: weights (B,) of the stretches. temper: the data count as this many times fewer.
        fixed: keys that stay at the model file's values.
        """
        A, g, square = self.A, self.g, self.square
        if blocks is not None:
            A = np.tensordot(blocks, self.normal.information, 1)
            g = blocks @ self.normal.score
            square = float(blocks @ self.normal.square)
        return solve(
            A / temper, g / temper, square / temper, self.precision(active, fixed), self.shift
        )

    def held_out(self, x: Array, blocks: Array) -> Array:
        """Log likelihood (B,) of stretches for a solution x (P,), but for constants."""
        inside = np.einsum("p,bpq,q->b", x, self.normal.information, x)
        said: Array = -0.5 * blocks * (self.normal.square - 2.0 * self.normal.score @ x + inside)
        return said

    def dispersion(self, x: Array) -> Array:
        """How much more the stretches' scores scatter than their information says, (P,)."""
        left = self.normal.score - self.normal.information @ x
        said = np.einsum("bpp->bp", self.normal.information).sum(axis=0)
        spread = np.sum(left**2, axis=0) / np.maximum(said, 1e-30)
        return np.asarray(np.maximum(1.0, spread), dtype=float)


def solve(A: Array, g: Array, square: float, precision: Array, shift: Array) -> Fit:
    """Evidence and solution from sums; see the module's formula."""
    scale = 1.0 / np.sqrt(precision)
    M = A * np.outer(scale, scale)
    M[np.diag_indices_from(M)] += 1.0
    h = scale * g - shift / scale
    factor = cho_factor(M, lower=True)
    z = cho_solve(factor, h)
    log_det = 2.0 * float(np.sum(np.log(np.diag(factor[0]))))
    chi2 = square + float(np.sum(shift**2 * precision)) - float(h @ z)
    return Fit(-0.5 * (chi2 + log_det), z * scale, factor, scale)
