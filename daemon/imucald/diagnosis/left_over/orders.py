"""Find a speed signal that oscillates once or twice per wheel turn.

An effect of the wheel is periodic in distance, not in time (order analysis; Fyfe and Munck 1997).
Between two samples a wheel may turn several times, and aliasing then moves the oscillation to any
frequency. The waves are therefore evaluated at the positions of the samples, from the integrated
speed. Between segments, the phase is free. A road may be periodic with 4 m and more (concrete
slabs), so such wavelengths are not tested.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.stats import gamma

from imucald.core.arrays import Array
from imucald.diagnosis.fit.chance import Answer
from imucald.diagnosis.fit.score import one_in_fifteen
from imucald.diagnosis.left_over.remains import LEAST_SEGMENTS, DriveResiduals, Remains

ROUND_M = 1.5, 2.3
"""Smallest and largest circumference of a tyre of a passenger car or van [m]: 155/65 R13 has 1.60
m, 235/65 R17 has 2.27 m."""
ONCE = {1: "once", 2: "twice"}
"""Oscillations per turn of the wheel: one for a wheel that is off-centre, two for an oval wheel."""
RUN_OUT = 1.5 / 300.0
"""Allowed run-out as a share of the radius: a tyre with a larger run-out must be replaced (1.5 mm,
workshop manuals of cars). A ring of teeth or magnets in a bearing has a smaller run-out."""
DRIVING_MPS = 3.0
LEAST_KNOTS = 20
SLOW_TERMS = 6
"""Number of polynomials that absorb drifts within a segment: up to about 0.1 Hz in 30 s."""


@dataclass(frozen=True)
class Stretch:
    """Consecutive speed samples (knots) of a segment. Arrays are (n,)."""

    way: Array
    """Travelled distance [m]."""
    speed: Array
    """Speed from the accelerometer, with the slow parts of the speed signal [m/s]."""
    left: Array
    """Speed signal minus the speed from the accelerometer [m/s]. Slow parts are removed."""
    known: Array
    """Orthonormal columns (n, q) that were removed."""


def orders(left: Remains) -> Iterator[Answer]:
    """Test whether the speed's residual is periodic with a wheel turn."""
    some = [s for drive in left.drives for s in _stretches(drive)]
    if len(some) < LEAST_SEGMENTS:
        return
    longest = max(float(s.way[-1] - s.way[0]) for s in some)
    low, high = 1.0 / ROUND_M[1], 1.0 / ROUND_M[0]
    for k in ONCE:
        # Twice as many waves as the length of a segment resolves.
        count = int(2.0 * k * (high - low) * longest) + 1
        yield _answer(some, np.linspace(k * low, k * high, count), k)


def _answer(some: Sequence[Stretch], turns: Array, harmonic: int) -> Answer:
    """Return the answer about the strongest wave. turns: (F,) waves per metre."""
    gains, powers, energies = (np.empty((len(some), len(turns))) for _ in range(3))
    for b, s in enumerate(some):
        gains[b], powers[b], energies[b] = _of_stretch(s, turns)
    # One segment in fifteen must not decide.
    kept = len(some) - one_in_fifteen(len(some))
    total = np.sort(gains, axis=0)[:kept].sum(axis=0)
    # The log likelihood ratio of two free numbers has the mean 1 (Wilks) if the noise level is
    # right; the other waves show its real level.
    usual = max(float(np.median(total)) / float(gamma.median(kept)), 1.0)
    best = int(np.argmax(total))
    p = min(len(turns) * float(gamma.sf(total[best] / usual, kept)), 1.0)
    size = float(np.sqrt(max(powers[:, best].sum(), 0.0) / energies[:, best].sum()))
    text = (
        f"the residual oscillates {ONCE[harmonic]} per {harmonic / turns[best]:.2f} m driven, "
        f"which is the circumference of a wheel. The amplitude is {100.0 * size:.2g} % of the "
        f"speed; a wheel without faults causes {100.0 * RUN_OUT:.2g} % at most"
    )
    return Answer("accel_x", size, RUN_OUT, p, text)


def _of_stretch(s: Stretch, turns: Array) -> tuple[Array, Array, Array]:
    """Return three values for each wave (F,): the gain in log likelihood from an oscillating gain
    of the speed, its power beyond noise, and the energy of an oscillation with amplitude 1."""
    phase = 2.0 * np.pi * np.outer(s.way, turns)
    X = np.stack([np.cos(phase), np.sin(phase)]) * s.speed[:, None]
    X -= s.known @ (s.known.T @ X)
    cc, ss = (X * X).sum(axis=1)
    cs = (X[0] * X[1]).sum(axis=0)
    c, d = s.left @ X
    room = np.maximum(cc * ss - cs**2, 1e-9 * (cc + ss) ** 2 + 1e-300)
    explained = (ss * c**2 - 2.0 * cs * c * d + cc * d**2) / room
    whole = float(s.left @ s.left)
    free = len(s.left) - s.known.shape[1] - 2
    share = np.clip(explained / max(whole, 1e-300), 0.0, 1.0 - 1e-9)
    noise = (whole - explained) / free
    # With n free numbers, -(n/2) log(1 - R^2) exceeds any x with a chance of exp(-x).
    return -0.5 * free * np.log(1.0 - share), explained - 2.0 * noise, 0.5 * (cc + ss)


def _stretches(drive: DriveResiduals) -> Iterator[Stretch]:
    """Yield, for each segment, the longest part that has all needed data."""
    f, _, found, _, masks = drive
    if "accel_x" not in found.of or not f.has_gravity:
        return
    left, mask = found.of["accel_x"].ravel(), masks["accel_x"].ravel()
    tilt = [x.ravel() for x in found.tilt["accel_x"]]
    knots, v = f.knots, np.abs(f.drive.knots.values)
    dt = np.diff(knots)
    # Between two knots the equation has one constant value.
    row = np.clip(np.searchsorted(f.t, 0.5 * (knots[1:] + knots[:-1])), 0, len(f.t) - 1)
    inside = (knots[:-1] >= f.t[0]) & (knots[1:] <= f.t[-1])
    good = mask[row] & inside & (np.minimum(v[1:], v[:-1]) > DRIVING_MPS)
    block = np.where(good, row // f.rows, -1)
    edges = np.flatnonzero(np.diff(block, prepend=-2, append=-2))
    longest: dict[int, tuple[int, int]] = {}
    for first, last in pairwise(edges.tolist()):
        b = int(block[first])
        if b >= 0 and last - first > np.ptp(longest.get(b, (0, 0))):
            longest[b] = first, last
    for first, last in longest.values():
        q = SLOW_TERMS + len(tilt)
        if last - first + 1 < max(LEAST_KNOTS, 2.0 * q):
            continue
        part = slice(first, last)
        sums = [_summed(x[row[part]] * dt[part]) for x in (left, *tilt)]
        at = np.linspace(-1.0, 1.0, last - first + 1)
        slow = np.polynomial.legendre.legvander(at, SLOW_TERMS - 1)
        known = np.linalg.qr(np.column_stack([slow, *sums[1:]]))[0]
        # The residual of the force is that of the speed's slope with the opposite sign.
        y = -sums[0]
        y -= known @ (known.T @ y)
        # A distance cannot be found from a speed that oscillates between its samples.
        smooth = v[first : last + 1] - y
        way = _summed(0.5 * (smooth[1:] + smooth[:-1]) * dt[part])
        yield Stretch(way, smooth, y, known)


def _summed(x: Array) -> Array:
    return np.concatenate([[0.0], np.cumsum(x)])
