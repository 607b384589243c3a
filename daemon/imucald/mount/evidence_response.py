"""Response of the specific force to dv/dt and to v r, and of the rate to turning.

With e the rotation-vector error of R (R_true = exp([e]) R), A = dv/dt, V = v r, F = R f_s and
(p, q, r) = R w_s, to first order

    F_x = gx A + e_z gy V      F_y = gy V - e_z gx A      F_z = e_y gx A - e_x gy V - v q
    p = p_road - e_y r         q = q_road + e_x r,

so noise in A itself costs gain but turns nothing. Small terms go along as nuisance with priors:
lever arm (r^2; heave of a pitching body, w^2 A), squat and body roll to second order (A^2, V^2,
A r, V r), sideslip (r^2, V^2, A V). That gives six sources: e_z and e_y from A, e_z and e_x from V,
e_x and e_y from the axis of rotation in turns.

Noise has another colour on each axis: slopes are red, rough roads and the rounding of a speed are
blue. Each band and axis has its own noise level, learnt from what the fit leaves over, and a
window that is worse than usual counts for less (Student's t weights; Lange, Little and Taylor,
J. Am. Stat. Assoc. 84, 1989). The variance comes from the spread of the scores from road
segment to road segment (sandwich; White, Econometrica 48, 1980), because noise is correlated.
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
"""Windows kept whole (7 min): those can be weighed afresh; older ones are only summed."""
FOLD = 16
"""So many windows, or a few more to whole groups, are summed up when the store is full."""
MAX_GROUPS = 2000
"""Groups kept apart (14 h); then neighbours are joined."""
GROUP = WINDOW // BLOCK_TICKS
"""Hops per segment of the sandwich: 25.6 s, one window's length."""
AFRESH = 8
"""All kept windows are weighed afresh every so many blocks."""
YOUNG = 20
"""Up to so many windows each fit weighs all of them afresh."""
TRUST = 4.0
"""Windows after which learnt noise levels count as much as their priors, roughly."""
LONE = 12.0
"""A level that rests on fewer windows than this is mostly that of all windows together."""
NU_MIN, NU_MAX = 1.5, 40.0
"""Degrees of freedom of a window's noise level; how even roads are is learnt per axis."""
UNEVEN, UNEVEN_WINDOWS = 2.0, 16.0
"""Kurtosis over that of even noise until windows speak, and its weight in windows."""
PER_TICK = 0.5 * WINDOW / BLOCK_TICKS
"""From the power per bin of a window to that per tick."""
FORCE_FLOOR, RATE_FLOOR = 0.01**2, 0.001**2
"""No band is trusted beyond this noise per tick [(m/s^2)^2], [(rad/s)^2]."""
FORCE_PRIOR, RATE_PRIOR = 0.2**2, 0.02**2
"""Noise per tick until the first windows speak."""
MEAN_SHARE = 1.0
"""The mean of a window counts as no less noisy than that share of the band above: what is not
known of the bias is the same in all windows, so that what they leave over does not show it."""
LEAST_DRIFT = 0.005
"""A drift that comes to less [rad], 0.3 deg, over the windows kept does not change weights."""
SLOW = slice(2, 4)
"""Bands above the slopes, and below where a speed that comes once a second has lost its changes."""
_AXES = [row.axis for row in ROWS]
_PRIOR = np.array([[FORCE_PRIOR]] * 4 + [[RATE_PRIOR]] * 2)
_FLOOR = np.array([[FORCE_FLOOR]] * 4 + [[RATE_FLOOR]] * 2)
LEAST_POWER = 1e-12
_MOTION = PAIR[Term.DVDT, Term.DVDT], PAIR[Term.LATERAL, Term.LATERAL]
_POWERS = np.array(
    [_MOTION] * ROLL_ROW + [(_MOTION[1], -1)] + [(PAIR[Term.YAW_RATE, Term.YAW_RATE], -1)] * 2
)
"""Of each row, the products whose sum is a window's power; -1: none."""


def _first_of_each(group: NDArray[np.int64]) -> NDArray[np.int64]:
    """Places at which another group begins, in (n,) that never decrease."""
    begins = np.ones(len(group), dtype=bool)
    np.not_equal(group[1:], group[:-1], out=begins[1:])
    return begins.nonzero()[0]


class ResponseEvidence:
    """Windows of products, their fit for a given R, and the sums of those gone by."""

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
        """Number of the road segment (sandwich group) that is being driven."""
        return self.blocks // GROUP

    @property
    def windows(self) -> int:
        """Windows kept whole."""
        return self._n

    def slow_gains(self) -> tuple[float, float]:
        """Of dv/dt and v r where neither slopes nor a slow source of the speed change them."""
        x, y = self.gains[:2, SLOW].sum(axis=1).tolist()
        return x / 2.0, y / 2.0

    def start_from(self, other: ResponseEvidence) -> None:
        """Begin with another's gains, noise levels and delays."""
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
        """Weigh windows about an angle that drifts; so far they counted as outliers for it.

        rate: (3,) [rad/segment]; since_middle: (3,) segments from where the angle is its mean.
        """
        was = self._drift
        self._drift, self._drift_middle = rate, self.segment - since_middle
        if np.abs((rate - was) * since_middle).max() > LEAST_DRIFT:
            self._scored = 0

    def set_delays(self, speed: float, turn: float) -> None:
        """Form the kept windows' products afresh with other delays [s]."""
        self.delays = (speed, turn)
        for i in range(self._n):
            sp.put_products(self._products, i, self._spectra[i], speed, turn)
        self._scored = 0

    def forget_sums(self) -> None:
        """Leave the windows gone by: their delay was another, and they cannot be formed afresh."""
        self._old_score, self._old_normal = self._old_score[:, :0], self._old_normal[:, :0]

    def direction_sums(self) -> tuple[Array, Array, float, float]:
        """Sums over windows and bands: response to A (3,), to V (3,), power of A, of V."""
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
        """Direction of forward in level axes [rad], without speed, and how sure its sign is.

        The principal axis of the level force, what turning explains taken off; forward is where
        the force to the left goes with turning to the left. The sign's sureness is a correlation.
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
        """How far two sources of an angle lie apart; None where one is missing or knows little."""
        found = {series.kind: series for series in self.series}
        return apart(found[one], found[other]) if {one, other} <= found.keys() else None

    def _turn_scores(self, turned: Array) -> None:
        """Scores about another R: to first order the angle's coefficient moves."""
        k = self._scored
        e = turned[_AXES][:, None, None]
        self._old_score -= self._old_normal[:, :, :, 0] * e
        self._score[:, :k] -= self._normal[:, :k, :, 0] * e

    def _fold(self) -> None:
        """Sum the oldest windows up, in whole groups, and let them go."""
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
        """Score the windows that are not scored yet; all of them also renew levels and gains."""
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
        """Power that the last windows leave over, less what a drift of the angles makes of it."""
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
        """Noise per tick, band and axis, and degrees of freedom, of windows and their weights."""
        self.nu, self.noise = self._evenness(left), self._levels(P, weight, left)

    @staticmethod
    def _evenness(left: Array) -> Array:
        """Degrees of freedom from the kurtosis of what is left: few where roads are uneven.

        For Student's t it is (nu - 2) / (nu - 4) times that of chi^2, which gives 4 + 2 / excess;
        lower by `NU_MIN` instead of 4 is what served best in simulated drives.
        """
        n = left.shape[1]
        size = left / np.maximum(left.sum(axis=1) / n, LEAST_POWER)[:, None, :]
        kurtosis = (size * size).sum(axis=1) / n / (1.0 + 1.0 / BAND_WIDTH)
        mean = (kurtosis * (BAND_WIDTH / BAND_WIDTH.sum())).sum(axis=1)
        excess = (n * mean + UNEVEN_WINDOWS * UNEVEN) / (n + UNEVEN_WINDOWS) - 1.0
        nu = NU_MIN + 2.0 / np.maximum(excess, 0.05)
        return np.asarray(np.minimum(nu, NU_MAX)[:, None, None])

    def _levels(self, P: Array, weight: Array, left: Array) -> Array:
        """Noise per tick, band and axis, of windows weighted by what they show."""
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
