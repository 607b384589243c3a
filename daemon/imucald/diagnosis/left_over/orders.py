"""A speed that swings once or twice a turn of a wheel.

Order analysis: what turns with the wheel is periodic in the way travelled and not in time, however
seldom the speed is sampled; between two samples a wheel may turn several times, and the swing is
folded to anywhere (Fyfe and Munck, Analysis of computed order tracking, 1997). So the waves are
taken at the samples' own places. The way by the speed itself keeps its phase within a segment; from
segment to segment nothing is asked of the phase. A road is periodic from 4 m on (slabs of
concrete), where nothing is looked for.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.stats import gamma

from imucald.core.arrays import Array
from imucald.diagnosis.equations.forward import Forward
from imucald.diagnosis.fit.chance import Question
from imucald.diagnosis.fit.score import Problem, one_in_fifteen
from imucald.diagnosis.result import TURNS_WITH_WHEEL, Structure
from imucald.diagnosis.search.state import State

ROUND_M = 1.5, 2.3
"""Once round a tyre of a passenger car or van: 155/65 R13 is 1.60 m, 235/65 R17 is 2.27 m."""
ONCE = {1: "once", 2: "twice"}
"""A turn: how often a wheel that is not centred, and one that is oval, swings."""
RUN_OUT = 1.5 / 300.0
"""Of the radius: a tyre on its wheel that is less round is to be exchanged (1.5 mm, workshop
manuals of cars). A ring of teeth or magnets in a bearing is rounder."""
DRIVING_MPS = 3.0
LEAST_KNOTS = 20
LEAST_SEGMENTS = 6
SLOW_TERMS = 6
"""Polynomials that take what drifts within a segment: up to some 0.1 Hz in 30 s."""
FREE = 4.0
"""Coefficients of the residual, over those that are fitted, that must be left."""
FINE = 2.0
"""Waves tried, over those that a segment's length tells apart."""


@dataclass(frozen=True)
class Stretch:
    """Knots of a speed within a segment, one after another. (n,)"""

    way: Array
    """Travelled [m]."""
    speed: Array
    """As the accelerometer says it beside the speed's slow parts [m/s]."""
    left: Array
    """Speed less what the accelerometer says of it [m/s], slow parts taken off."""
    known: Array
    """(n, q) orthonormal: what was taken off."""


def orders(problem: Problem, state: State) -> list[Question]:
    """Whether what is left of the speed goes round with a wheel."""
    return asked_of(state.forwards, problem.fitted_changes())


def asked_of(forwards: Sequence[Forward], changes: Mapping[str, float]) -> list[Question]:
    """Of drives beside their model. changes: what fits them, within its box."""
    some = [s for f in forwards for s in _stretches(f, changes)]
    if len(some) < LEAST_SEGMENTS:
        return []
    longest = max(float(s.way[-1] - s.way[0]) for s in some)
    low, high = 1.0 / ROUND_M[1], 1.0 / ROUND_M[0]
    made = []
    for k in ONCE:
        count = int(FINE * k * (high - low) * longest) + 1
        made.append(_question(some, np.linspace(k * low, k * high, count), k))
    return made


def _question(some: Sequence[Stretch], turns: Array, harmonic: int) -> Question:
    """turns: (F,) waves a metre."""
    gains, powers, energies = (np.empty((len(some), len(turns))) for _ in range(3))
    for b, s in enumerate(some):
        gains[b], powers[b], energies[b] = _of_stretch(s, turns)
    # One segment in fifteen must not decide.
    kept = len(some) - one_in_fifteen(len(some))
    total = np.sort(gains, axis=0)[:kept].sum(axis=0)
    # A ratio of likelihoods of two free numbers has the mean 1 (Wilks), if noise is what is taken
    # for it; other waves show what it has.
    usual = max(float(np.median(total)) / float(gamma.median(kept)), 1.0)
    best = int(np.argmax(total))
    p = min(len(turns) * float(gamma.sf(total[best] / usual, kept)), 1.0)
    size = float(np.sqrt(max(powers[:, best].sum(), 0.0) / energies[:, best].sum()))
    text = (
        f"the residual oscillates {ONCE[harmonic]} in {harmonic / turns[best]:.2f} m of the "
        f"way, with an amplitude of {100.0 * size:.2g} % of the speed. It turns with a wheel; "
        f"a sound wheel makes {100.0 * RUN_OUT:.2g} %"
    )
    return Question(p, size > RUN_OUT, Structure("accel_x", TURNS_WITH_WHEEL, size / RUN_OUT, text))


def _of_stretch(s: Stretch, turns: Array) -> tuple[Array, Array, Array]:
    """By wave (F,): log likelihood that a swing of the speed's gain brings, its power beyond noise,
    and the energy of a swing of one."""
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
    # Of n free numbers, -(n/2) log(1 - R^2) exceeds any x with a chance of exp(-x).
    return -0.5 * free * np.log(1.0 - share), explained - 2.0 * noise, 0.5 * (cc + ss)


def _stretches(f: Forward, changes: Mapping[str, float]) -> Iterator[Stretch]:
    """The longest part of each segment that has all that is needed."""
    found, masks = f.residuals(changes), f.usable()
    if "accel_x" not in found.of or not f.has_gravity:
        return
    left, mask = found.of["accel_x"].ravel(), masks["accel_x"].ravel()
    tilt = [x.ravel() for x in found.tilt["accel_x"]]
    knots, v = f.knots, np.abs(f.drive.knots.values)
    dt = np.diff(knots)
    # Between two knots the equation is one number, which lasts.
    row = np.clip(np.searchsorted(f.t, 0.5 * (knots[1:] + knots[:-1])), 0, len(f.t) - 1)
    inside = (knots[:-1] >= f.t[0]) & (knots[1:] <= f.t[-1])
    good = mask[row] & inside & (np.minimum(v[1:], v[:-1]) > DRIVING_MPS)
    block = np.where(good, row // f.rows, -1)
    edges = np.flatnonzero(np.diff(block, prepend=-2, append=-2))
    longest: dict[int, tuple[int, int]] = {}
    for first, last in pairwise(edges.tolist()):
        b = int(block[first])
        if b >= 0 and last - first > _length(longest.get(b, (0, 0))):
            longest[b] = first, last
    for first, last in longest.values():
        q = SLOW_TERMS + len(tilt)
        if last - first + 1 < max(LEAST_KNOTS, FREE * q / 2.0):
            continue
        part = slice(first, last)
        sums = [_summed(x[row[part]] * dt[part]) for x in (left, *tilt)]
        at = np.linspace(-1.0, 1.0, last - first + 1)
        slow = np.polynomial.legendre.legvander(at, SLOW_TERMS - 1)
        known = np.linalg.qr(np.column_stack([slow, *sums[1:]]))[0]
        # What is left of the force is the speed's slope with the other sign.
        y = -sums[0]
        y -= known @ (known.T @ y)
        # The way of a speed that swings between its samples is none.
        smooth = v[first : last + 1] - y
        way = _summed(0.5 * (smooth[1:] + smooth[:-1]) * dt[part])
        yield Stretch(way, smooth, y, known)


def _length(span: tuple[int, int]) -> int:
    return span[1] - span[0]


def _summed(x: Array) -> Array:
    return np.concatenate([[0.0], np.cumsum(x)])
