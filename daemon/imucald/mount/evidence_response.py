"""Response of the specific force to dv/dt and to v r, and of the rate to turning.

Let e be the rotation-vector error of R (R_true = exp([e]) R), A = dv/dt, V = v r, F = R f_s and (p,
q, r) = R w_s. To first order:

    F_x = gx A + e_z gy V      F_y = gy V - e_z gx A      F_z = e_y gx A - e_x gy V - v q
    p = p_road - e_y r         q = q_road + e_x r,

Noise in A itself therefore reduces the gain but does not change an angle. Small terms are fitted as
nuisances with priors: lever arm (r^2; heave of a pitching body, w^2 A), squat and body roll to
second order (A^2, V^2, A r, V r), sideslip (r^2, V^2, A V). The fit gives six sources: e_z and e_y
from A, e_z and e_x from V, e_x and e_y from the axis of rotation in turns.

The noise has a different spectrum on each axis: slopes have low frequencies, rough roads and the
rounding of a speed have high frequencies. Each band and axis has its own noise level, learnt from
the residuals of the fit. A window that is worse than usual gets less weight (Student's t weights;
Lange, Little and Taylor, J. Am. Stat. Assoc. 84, 1989). The variance comes from the spread of the
scores between road segments (sandwich; White, Econometrica 48, 1980), because the noise is
correlated.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imucald.core.arrays import Array
from imucald.core.rotations import Matrix3, vector_from_rotation
from imucald.mount import evidence_spectra as sp
from imucald.mount.evidence_rows import (
    GAINS,
    MAX_REGRESSORS,
    P_ROW,
    ROLL_ROW,
    ROWS,
    left_over,
    less_angle,
    put_scores,
    renewed_gains,
)
from imucald.mount.evidence_spectra import (
    BAND_WIDTH,
    BANDS,
    BINS,
    MEASURED,
    PAIR,
    PRODUCTS,
    WINDOW,
    Measured,
    Term,
)
from imucald.mount.road_segments import AngleEvidence, ScoreSeries, apart, fit_regressions
from imucald.mount.signal_blocks import BLOCK_TICKS

KEPT = 64
"""Number of windows stored completely (7 min).

These can be weighed again; older windows exist only as sums.
"""
FOLD = 16
"""Number of windows, rounded up to whole groups, that are summed when the store is full."""
MAX_GROUPS = 2000
"""Number of groups stored separately (14 h); beyond it, neighbours are joined."""
GROUP = WINDOW // BLOCK_TICKS
"""Blocks per segment of the sandwich: 25.6 s, one window's length."""
AFRESH = 8
"""All stored windows are weighed again once in this many blocks."""
YOUNG = 20
"""Up to this many windows, each fit weighs all of them again."""
TRUST = 4.0
"""Number of windows after which learnt noise levels count roughly as much as their priors."""
LONE = 12.0
"""A noise level from fewer windows than this comes mostly from all windows together."""
NU_MIN, NU_MAX = 1.5, 40.0
"""Degrees of freedom of a window's noise level.

They describe how even roads are and are learnt per axis.
"""
UNEVEN, UNEVEN_WINDOWS = 2.0, 16.0
"""Prior of the kurtosis relative to that of even noise, and its weight in windows."""
PER_TICK = 0.5 * WINDOW / BLOCK_TICKS
"""Factor from the power per bin of a window to the power per tick."""
FORCE_FLOOR, RATE_FLOOR = 0.01**2, 0.001**2
"""Smallest noise per tick that is assumed in any band [(m/s^2)^2], [(rad/s)^2]."""
FORCE_PRIOR, RATE_PRIOR = 0.2**2, 0.02**2
"""Noise per tick before the first windows."""
MEAN_SHARE = 1.0
"""Smallest noise of a window's mean, as a share of the noise of the band above.

The unknown part of the bias is the same in all windows, so their residuals do not show it.
"""
LEAST_DRIFT = 0.005
"""A drift of less than this [rad], 0.3 deg, over the stored windows does not change the weights."""
SLOW = slice(2, 4)
"""Bands above the slopes and below the frequencies that a speed of one sample per second cannot
show.
"""
_AXES = [row.axis for row in ROWS]
_PRIOR = np.array([[FORCE_PRIOR]] * 4 + [[RATE_PRIOR]] * 2)
_FLOOR = np.array([[FORCE_FLOOR]] * 4 + [[RATE_FLOOR]] * 2)
LEAST_POWER = 1e-12
_MOTION = PAIR[Term.DVDT, Term.DVDT], PAIR[Term.LATERAL, Term.LATERAL]
_POWERS = np.array(
    [_MOTION] * ROLL_ROW + [(_MOTION[1], -1)] + [(PAIR[Term.YAW_RATE, Term.YAW_RATE], -1)] * 2
)
"""For each row, the products whose sum is a window's power; -1: none."""


def _first_of_each(group: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the places at which a new group begins, in (n,) numbers that never decrease."""
    begins = np.ones(len(group), dtype=bool)
    np.not_equal(group[1:], group[:-1], out=begins[1:])
    return begins.nonzero()[0]


class ResponseEvidence:
    """Windows of products, their fit for a given R, and the sums of older windows."""

    def __init__(self) -> None:
        self._products = np.zeros((PRODUCTS, KEPT, BANDS))
        self._spectra = np.zeros((KEPT, BINS, MEASURED), dtype=np.complex128)
        self._block_number = np.zeros(KEPT, dtype=np.int64)
        self._n = self._scored = 0
        self.blocks = 0
        self._last_afresh = 0
        self.noise = np.full((6, BANDS), FORCE_PRIOR)
        self.noise[4:] = RATE_PRIOR
        self.nu = np.full((6, 1, 1), NU_MIN)
        self.gains = np.zeros((len(GAINS), BANDS))
        self.gains[:2] = 1.0
        self._score = np.zeros((len(ROWS), KEPT, MAX_REGRESSORS))
        self._normal = np.zeros((len(ROWS), KEPT, MAX_REGRESSORS, MAX_REGRESSORS))
        self._old_score = np.zeros((len(ROWS), 0, MAX_REGRESSORS))
        self._old_normal = np.zeros((len(ROWS), 0, MAX_REGRESSORS, MAX_REGRESSORS))
        self._R, self._fitted = np.eye(3), False
        self.delays = (0.0, 0.0)
        self.series: list[ScoreSeries] = []
        self._drift, self._drift_middle = np.zeros(3), np.zeros(3)
        self.without_speed = False

    @property
    def segment(self) -> int:
        """Number of the current road segment (sandwich group)."""
        return self.blocks // GROUP

    @property
    def windows(self) -> int:
        """Number of windows stored completely."""
        return self._n

    def slow_gains(self) -> tuple[float, float]:
        """Gains of dv/dt and v r in bands that neither slopes nor a slow speed source disturb."""
        x, y = self.gains[:2, SLOW].sum(axis=1).tolist()
        return x / 2.0, y / 2.0

    def start_from(self, other: ResponseEvidence) -> None:
        """Begin with the gains, noise levels and delays of another object."""
        self.gains, self.noise = other.gains.copy(), other.noise.copy()
        self.nu = other.nu
        self.delays = other.delays

    def add(self, s: sp.Spectra) -> None:
        """Take a window's spectra (BINS, MEASURED)."""
        self.blocks += 1
        if self._n == KEPT:
            self._fold()
        k = self._n
        self._spectra[k] = s
        sp.put_products(self._products, k, s, *self.delays)
        self._block_number[k] = self.blocks
        self._n += 1

    def follow_drift(self, rate: Array, since_middle: Array) -> None:
        """Weigh windows about a drifting angle; so far they counted as outliers for that angle.

        rate: (3,) [rad/segment]; since_middle: (3,) segments since the angle equalled its mean.
        """
        was = self._drift
        self._drift, self._drift_middle = rate, self.segment - since_middle
        if np.abs((rate - was) * since_middle).max() > LEAST_DRIFT:
            self._scored = 0

    def set_delays(self, speed: float, turn: float) -> None:
        """Compute the products of the stored windows again with other delays [s]."""
        self.delays = (speed, turn)
        for i in range(self._n):
            sp.put_products(self._products, i, self._spectra[i], speed, turn)
        self._scored = 0

    def forget_sums(self) -> None:
        """Drop the sums of older windows: they used another delay and cannot be computed again."""
        self._old_score, self._old_normal = self._old_score[:, :0], self._old_normal[:, :0]

    def direction_sums(self) -> tuple[Array, Array, float, float]:
        """Return sums over windows and bands: response to A (3,), to V (3,), power of A, of V."""
        p = self._products[:, : self._n].sum(axis=(1, 2))
        to_a = np.array([p[sp.place(i, Measured.DVDT)] for i in range(3)])
        to_v = np.array([p[sp.place(i, Measured.LATERAL)] for i in range(3)])
        return (
            to_a,
            to_v,
            float(p[sp.place(Measured.DVDT, Measured.DVDT)]),
            float(p[sp.place(Measured.LATERAL, Measured.LATERAL)]),
        )

    def principal_direction(self, level: Matrix3) -> tuple[float, float]:
        """Return the direction of forward in level axes [rad], found without speed, and the
        certainty of its sign.

        The direction is the principal axis of the level force after subtracting what turning
        explains. Forward is the sign for which the force to the left goes with turning to the left.
        The certainty of the sign is a correlation.
        """
        p = self._products[:, : self._n].sum(axis=(1, 2))
        C = np.array([[p[sp.place(i, j)] for j in range(3)] for i in range(3)])
        C = level @ C @ level.T
        to_v = level @ np.array([p[sp.place(i, Measured.LATERAL)] for i in range(3)])
        power = max(float(p[sp.place(Measured.LATERAL, Measured.LATERAL)]), 1e-9)
        left = C[:2, :2] - np.outer(to_v[:2], to_v[:2]) / power
        _, vectors = np.linalg.eigh(left)
        x, y = (float(c) for c in vectors[:, 1])
        across = x * to_v[1] - y * to_v[0]
        sign = 1.0 if across > 0.0 else -1.0
        share = abs(across) / float(np.sqrt(power * max(C[0, 0] + C[1, 1], 1e-9)))
        return float(np.arctan2(sign * y, sign * x)), share

    def fit(self, R: Matrix3) -> dict[str, AngleEvidence]:
        """Fit gains, noise levels and the sources of e about R; old sums included."""
        if self._n == 0:
            return {}
        turned = vector_from_rotation(R @ self._R.T)
        large = float(np.abs(turned).max()) > 0.005
        if (
            self._scored == 0
            or self._n <= YOUNG
            or large
            or self.blocks - self._last_afresh >= AFRESH
        ):
            self._scored = 0
            self._last_afresh = self.blocks
        self._turn_scores(turned)
        self._R, self._fitted = R.copy(), True
        if self._scored < self._n:
            self._weigh(R)
        return self._sources()

    def apart(self, one: str, other: str) -> AngleEvidence | None:
        """Return the difference between two sources of an angle; None if one is missing or
        uncertain.
        """
        found = {series.kind: series for series in self.series}
        return apart(found[one], found[other]) if {one, other} <= found.keys() else None

    def _turn_scores(self, turned: Array) -> None:
        """Move the scores to another R: to first order only the angle's coefficient changes."""
        k = self._scored
        e = turned[_AXES][:, None, None]
        self._old_score -= self._old_normal[:, :, :, 0] * e
        self._score[:, :k] -= self._normal[:, :k, :, 0] * e

    def _fold(self) -> None:
        """Sum the oldest windows in whole groups and delete them."""
        if self._fitted and self._scored < self._n:
            self._weigh(self._R)
        group = self._block_number[: self._n] // GROUP
        starts = _first_of_each(group)
        cut = int(starts[np.searchsorted(starts, FOLD)])
        use = starts[starts < cut]
        s = np.add.reduceat(self._score[:, :cut], use, axis=1)
        m = np.add.reduceat(self._normal[:, :cut], use, axis=1)
        self._old_score = np.concatenate([self._old_score, s], axis=1)
        self._old_normal = np.concatenate([self._old_normal, m], axis=1)
        if self._old_score.shape[1] > MAX_GROUPS:
            half = np.arange(0, self._old_score.shape[1], 2)
            self._old_score = np.add.reduceat(self._old_score, half, axis=1)
            self._old_normal = np.add.reduceat(self._old_normal, half, axis=1)
        left = self._n - cut
        self._products[:, :left] = self._products[:, cut : self._n].copy()
        for kept in (self._spectra, self._block_number):
            kept[:left] = kept[cut : self._n].copy()
        self._score[:, :left] = self._score[:, cut : self._n].copy()
        self._normal[:, :left] = self._normal[:, cut : self._n].copy()
        self._n = left
        self._scored = max(self._scored - cut, 0)

    def _weigh(self, R: Matrix3) -> None:
        """Score the windows without a score.

        When all windows are scored, levels and gains are renewed too.
        """
        first = self._scored
        P = sp.in_vehicle_axes(self._products, R, self.without_speed, first, self._n)
        weight = self._weights(self._left_over(P))
        if first == 0:
            self.gains = renewed_gains(P, weight)
            left = self._left_over(P)
            weight = self._weights(left)
            self._renew_levels(P, weight, left)
            weight = self._weights(left)
        put_scores(P, weight, self.gains, self._score, self._normal, first)
        self._scored = self._n

    def _left_over(self, P: Array) -> Array:
        """Return the residual power of the last windows, minus the part that a drift of the angles
        causes.
        """
        left = left_over(P, self.gains)
        segment = self._block_number[self._n - P.shape[1] : self._n] / GROUP
        angle = self._drift * (segment[:, None] - self._drift_middle)
        if np.abs(angle).max() < LEAST_DRIFT:
            return left
        return less_angle(left, P, self.gains, angle)

    def _weights(self, left: Array) -> Array:
        nu, dof = self.nu, 2.0 * BAND_WIDTH
        out: Array = (nu + dof) / (nu * self.noise[:, None, :] + 2.0 * PER_TICK * left)
        return out

    def _renew_levels(self, P: Array, weight: Array, left: Array) -> None:
        """Renew noise per tick, band and axis, and degrees of freedom, from windows and their
        weights.
        """
        self.nu, self.noise = self._evenness(left), self._levels(P, weight, left)

    @staticmethod
    def _evenness(left: Array) -> Array:
        """Return degrees of freedom from the kurtosis of the residuals: few where roads are uneven.

        For Student's t the kurtosis is (nu - 2) / (nu - 4) times that of chi^2, which gives 4 + 2 /
        excess. `NU_MIN` in place of the 4 worked best in simulated drives.
        """
        n = left.shape[1]
        size = left / np.maximum(left.sum(axis=1) / n, LEAST_POWER)[:, None, :]
        kurtosis = (size * size).sum(axis=1) / n / (1.0 + 1.0 / BAND_WIDTH)
        mean = (kurtosis * (BAND_WIDTH / BAND_WIDTH.sum())).sum(axis=1)
        excess = (n * mean + UNEVEN_WINDOWS * UNEVEN) / (n + UNEVEN_WINDOWS) - 1.0
        nu = NU_MIN + 2.0 / np.maximum(excess, 0.05)
        return np.asarray(np.minimum(nu, NU_MAX)[:, None, None])

    def _levels(self, P: Array, weight: Array, left: Array) -> Array:
        """Return noise per tick, band and axis, from windows weighted by their information."""
        n = left.shape[1]
        power = P[_POWERS[:, 0]]
        power[:ROLL_ROW] += P[_POWERS[:ROLL_ROW, 1]]
        even = left * (weight * self.noise[:, None, :])
        total = np.maximum(power.sum(axis=1), LEAST_POWER)
        weighted = (power * even).sum(axis=1) / total
        square = np.maximum((power * power).sum(axis=1), LEAST_POWER * LEAST_POWER)
        windows = total * total / square
        level = (windows * weighted + LONE * (even.sum(axis=1) / n)) / (windows + LONE)
        fresh = PER_TICK * level / BAND_WIDTH
        part = TRUST / (self._n + TRUST)
        trust = 1.0 - part * part
        noise: Array = np.maximum(trust * fresh + (1.0 - trust) * _PRIOR, _FLOOR)
        force = noise[:P_ROW]
        np.maximum(force[:, 0], MEAN_SHARE * force[:, 1], out=force[:, 0])
        return noise

    def _sources(self) -> dict[str, AngleEvidence]:
        group = self._block_number[: self._n] // GROUP
        starts = _first_of_each(group)
        score = np.add.reduceat(self._score[:, : self._n], starts, axis=1)
        normal = np.add.reduceat(self._normal[:, : self._n], starts, axis=1)
        score = np.concatenate([self._old_score, score], axis=1)
        normal = np.concatenate([self._old_normal, normal], axis=1)
        sources, self.series = fit_regressions(score, normal, self.without_speed)
        return sources
