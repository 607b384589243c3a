"""Find zeros and gains that change during a drive: from segment to segment, or with a condition.

A parameter of the model file is one number. If a segment's best number correlates with its
neighbours' numbers, or with speed, vibration or driving style, there is an effect that no parameter
describes. Every zero and gain is tested, even if it was not found to be wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.stats import t as student

from imucald.core.arrays import Array
from imucald.diagnosis.causes import PARAMETERS
from imucald.diagnosis.equations.forward import Forward
from imucald.diagnosis.fit.blocks import Table
from imucald.diagnosis.fit.box import box_fit
from imucald.diagnosis.fit.chance import FALSE_SHARE, Question, chance_of_large
from imucald.diagnosis.fit.moderated import moderated
from imucald.diagnosis.fit.score import REACH, Hypothesis, Problem
from imucald.diagnosis.outcome import first_signal
from imucald.diagnosis.result import DIFFERS, WANDERS, Structure
from imucald.diagnosis.search.state import State
from imucald.diagnosis.search.trials import on_table
from imucald.diagnosis.signals import STEP_S, DriveSignals, Mask
from imucald.mount.mount_words import SD_95

ASKED = ("bias", "scale", "offset")
"""Parts of the tested keys, which every sensor has. Delays, lever arm and springs are not tested:
they absorb errors of the tyre equations, which depend on the speed also in drives without an
effect."""
LAGS = (1, 2, 3)
"""Numbers of neighbouring segments, half a minute to a minute and a half: longer than a manoeuvre.
The duration of an effect is not known, so each is tested."""
LEAST_SIDE = 3
"""Fewest segments on either side of a moment."""
ORDERS, KEPT = 1000, 100
"""Permutations of the segments drawn at each level, and how many of them must reach the next
level."""
MOST_LEVELS = 8
"""Largest number of levels. It reaches a chance of 1e-8, less than any family of questions
needs."""
LEAST_WAVES = 3
"""Slower oscillations within a drive count as wandering."""
LEAST_BLOCKS = 8
EVENLY = 3.0**-0.5
"""Standard deviation of a uniform distribution within a tolerance, over the tolerance."""
EITHER_SIDE = 2.0
"""Width of the allowed range of a correct file, as a multiple of the tolerance."""
PARTS = 4
"""Independent parts of a segment: a manoeuvre lasts some seconds."""
EDGE = 1e-6
"""Share of a box's width that counts as its edge."""


@dataclass(frozen=True)
class Fit:
    """All parameters fitted within their box, those of a named drift last (Q of them)."""

    gram: Array
    """(B, Q+1, Q+1), residual first."""
    low: Array
    high: Array
    x: Array

    @staticmethod
    def of(problem: Problem, drift: Hypothesis | None) -> Fit:
        """drift: a named drift, which has no place in the model file; it is fitted too."""
        gram, low, high = problem.widened(drift)
        total = gram.sum(axis=0)
        return Fit(gram, low, high, box_fit(total[1:, 1:], total[1:, 0], low, high))

    @property
    def curvature(self) -> Array:
        """(B, Q, Q) second derivatives of each segment's loss."""
        return self.gram[:, 1:, 1:]

    @property
    def scores(self) -> Array:
        """(B, Q) negative gradients of each segment's loss."""
        return np.asarray(self.gram[:, 1:, 0] - self.curvature @ self.x)

    @property
    def is_free(self) -> Mask:
        """(Q,) parameters strictly inside their box. Only for these the gradients add up to
        zero."""
        edge = EDGE * (self.high - self.low)
        return np.asarray((self.x > self.low + edge) & (self.x < self.high - edge))

    def beside(self, j: int, by: Array, low: float, high: float) -> float:
        """Slope of parameter j over `by` (B,), with j itself between low and high and all other
        parameters anywhere in their box. low, high: bounds of both."""
        total, cross = self.gram.sum(axis=0), by @ self.gram[:, j + 1]
        H = np.block([[total[1:, 1:], cross[1:, None]],
                      [cross[None, 1:], by**2 @ self.curvature[:, j, j]]])  # fmt: skip
        c = np.append(total[1:, 0], cross[0])
        lows, highs = np.append(self.low, low), np.append(self.high, high)
        lows[j], highs[j] = low, high
        return float(box_fit(H, c, lows, highs)[-1])


def unstable(problem: Problem, state: State) -> list[Question]:
    """Questions about zeros and gains that wander from segment to segment, or differ between
    conditions."""
    if problem.table.blocks < LEAST_BLOCKS:
        return []
    fit = Fit.of(problem, drift_of(problem, state))
    asked = [j for j, key in enumerate(problem.table.keys)
             if any(part in ASKED for part in key.split("."))
             and fit.curvature[:, j, j].any()]  # fmt: skip
    return [
        *_wandering(problem, fit, asked),
        *_swinging(problem, fit, asked),
        *_jumping(problem, fit, asked),
        *_conditional(problem, fit, asked, conditions(problem, state)),
    ]


def drift_of(problem: Problem, state: State) -> Hypothesis | None:
    """The named drift, which has no place in the model file; None without one."""
    drifts = (t.hypothesis for t in state.named if t.hypothesis.pattern is not None)
    return next((on_table(h, problem.table) for h in drifts), None)


def _wandering(problem: Problem, fit: Fit, asked: list[int]) -> Iterator[Question]:
    """Test whether neighbouring segments share a departure that the whole drive does not show.

    Of scores s_b with information h_b, s_b s_(b+l) has the expectation h_b h_(b+l) sigma^2, where
    sigma is the standard deviation of the parameter's wander. The chance comes from permutations of
    the same segments.
    """
    for j in asked:
        h, s = _departures(fit, j)
        for lag in LAGS:
            together = partial(_shared, lag=lag)
            size = np.sqrt(max(float(together(s)), 0.0) / max(float(together(h)), 1e-300))
            p = _share_of_orders(s, np.eye(len(s)), together)
            # For random permutations the sum scatters about zero by this much.
            scatter = np.sqrt(lag / len(s)) * float(s @ s)
            limit = (EVENLY * _may_be(problem, j)) ** 2 * float(together(h))
            rare = float(student.sf(limit / max(scatter, 1e-300), len(s) - 1))
            yield _wander(
                problem, j, p, float(size), "changes by {} from piece to piece of the drive", rare
            )


def _swinging(problem: Problem, fit: Fit, asked: list[int]) -> Iterator[Question]:
    """Test whether segments one period apart agree: the strongest of all waves.

    If a parameter oscillates by A cos(w t), sum s_b e^(i w t) has the expectation A/2 sum h_b. Each
    drive has its own phase. The chance comes from permutations of the same segments.
    """
    table = problem.table
    apart = np.eye(int(table.drive.max()) + 1)[table.drive]
    hz = _frequencies(table)
    if not len(hz):
        return
    waves = np.exp(2j * np.pi * np.outer(table.start_s, hz))
    image = (apart[:, :, None] * waves[:, None, :]).reshape(table.blocks, -1)

    def power(z: Array) -> Array:
        """(N, F) power of the drives' sums along the waves (N, D F)."""
        return np.asarray((np.abs(z.reshape(len(z), -1, len(hz))) ** 2).sum(axis=1))

    def strongest(z: Array) -> Array:
        return np.asarray(power(z).max(axis=1))

    for j in asked:
        h, s = _departures(fit, j)
        own = power((s @ image)[None])[0]
        size = float(np.sqrt(2.0 * own.max() / np.sum((h @ apart) ** 2)))
        period = f"{1.0 / hz[own.argmax()]:.0f} s"
        how = f"changes back and forth by {{}} every {period}, or faster than segments can show"
        # By chance, a wave's power is exponentially distributed with the sum of squares as its
        # mean.
        limit = (EVENLY * _may_be(problem, j)) ** 2 * np.sum((h @ apart) ** 2) / 2.0
        rare = min(1.0, len(hz) * float(np.exp(-limit / max(float(s @ s), 1e-300))))
        yield _wander(problem, j, _share_of_orders(s, image, strongest), size, how, rare)


def _departures(fit: Fit, j: int) -> tuple[Array, Array]:
    """Information (B,) on a parameter, and its scores (B,), which add up to zero."""
    h, s = fit.curvature[:, j, j], fit.scores[:, j]
    return h, s - h * (s.sum() / h.sum())


def _wander(problem: Problem, j: int, p: float, size: float, how: str, rare: float) -> Question:
    """how: text with a placeholder for the amount `size`."""
    key = problem.table.keys[j]
    text = f"{key} {how.format(amount(key, size))}"
    return _question(problem, key, WANDERS, p, size / (EVENLY * _may_be(problem, j)), text, rare)


def _frequencies(table: Table) -> Array:
    """(F,) frequencies of waves that repeat within a drive, up to one wave per two segments
    [Hz]."""
    last = [float(np.ptp(table.start_s[table.drive == d])) for d in np.unique(table.drive)]
    whole = max(last) + table.seconds
    return np.arange(LEAST_WAVES, int(whole / (2.0 * table.seconds)) + 1) / whole


def _shared(s: Array, lag: int) -> Array:
    """Sum of the products of neighbours up to a lag: (..., B) to (...)."""
    return np.asarray(
        sum(np.einsum("...b,...b->...", s[..., n:], s[..., :-n]) for n in range(1, lag + 1))
    )


def _share_of_orders(s: Array, image: Array, size_of: Callable[[Array], Array]) -> float:
    """Share of all permutations of s (B,) with at least the size of the actual order. image: (B,
    F), linear map of s. size_of: maps its result (N, F) to sizes (N,).

    Subset simulation (Au and Beck 2001): levels are set so that a tenth of the permutations at one
    level reach the next. New permutations are made from these by exchanging two places; an exchange
    that would fall below the level is rejected. Therefore a share of 1e-6 takes six times as many
    draws as a share of a tenth, not 1e5 times.
    """
    rng, rows, share = np.random.default_rng(0), np.arange(ORDERS), 1.0
    x = s[np.argsort(rng.random((ORDERS, len(s))), axis=1)]
    z = x @ image
    got, size = size_of((s @ image)[None])[0], size_of(z)
    for _ in range(MOST_LEVELS):
        level = np.sort(size)[-KEPT]
        if level >= got:
            break
        reach = np.flatnonzero(size >= level)
        share *= len(reach) / ORDERS
        drawn = rng.choice(reach, ORDERS)
        x, z, size = x[drawn], z[drawn], size[drawn]
        for _ in range(len(s)):
            i, k = rng.integers(len(s), size=(2, ORDERS))
            by = x[rows, k] - x[rows, i]
            other = z + by[:, None] * (image[i] - image[k])
            new = size_of(other)
            stays = new < level
            z, size = np.where(stays[:, None], z, other), np.where(stays, size, new)
            by[stays] = 0.0
            x[rows, i] += by
            x[rows, k] -= by
    return share * float((1 + np.sum(size >= got)) / (ORDERS + 1))


def _jumping(problem: Problem, fit: Fit, asked: list[int]) -> Iterator[Question]:
    """Test for a zero or gain that changes at some moment; the chance is corrected for the number
    of moments."""
    B = problem.table.blocks
    moments: dict[str, Array] = {
        str(k): (np.arange(B) >= k).astype(float) for k in range(LEAST_SIDE, B - LEAST_SIDE + 1)
    }
    best: dict[int, ScoreTest] = {}
    rare: dict[int, float] = {}
    for test in _score_tests(problem, fit, asked, moments):
        rare[test.j] = rare.get(test.j, 0.0) + test.rare
        if test.j not in best or test.p < best[test.j].p:
            best[test.j] = test
    for j, test in best.items():
        key = problem.table.keys[j]
        size = abs(test.value) / (EITHER_SIDE * _may_be(problem, j))
        since = moment(problem.table, int(test.name))
        text = f"{key} differs by {amount(key, test.value)} from {since} on"
        p = min(test.p * len(moments), 1.0)
        yield _question(problem, key, WANDERS, p, size, text, min(rare[j], 1.0))


def moment(table: Table, segment: int) -> str:
    """Start of a segment in words; with several drives, also which drive."""
    at, drive = f"{table.start_s[segment]:.0f} s", int(table.drive[segment])
    return at if not table.drive.any() else f"{at} of drive {drive + 1}"


def _conditional(
    problem: Problem, fit: Fit, asked: list[int], some: Mapping[str, Array]
) -> Iterator[Question]:
    """Test for a zero or gain that changes with a condition."""
    shares = {}
    for name, c in some.items():
        low, high = np.quantile(c, [0.05, 0.95])
        if high > low:
            shares[name] = np.clip((c - low) / (high - low), 0.0, 1.0)
    for test in _score_tests(problem, fit, asked, shares):
        key = problem.table.keys[test.j]
        size = abs(test.value) / (EITHER_SIDE * _may_be(problem, test.j))
        text = f"{key} differs by {amount(key, test.value)} between {test.name} segments"
        yield _question(problem, key, DIFFERS, test.p, size, text, test.rare)


@dataclass(frozen=True)
class ScoreTest:
    """Result of a test. name: of the pattern. j: parameter. p: chance. value: size of the change.
    rare: chance that it looks too large if nothing is wrong."""

    name: str
    j: int
    p: float
    value: float
    rare: float


def _score_tests(
    problem: Problem, fit: Fit, asked: list[int], some: Mapping[str, Array]
) -> Iterator[ScoreTest]:
    """Tests of a column times a pattern over the segments, fitted with all others (score test,
    deviation from the scatter between segments).

    A parameter at the edge of its box cannot absorb a part of the pattern, and its gradient, which
    does not vanish there, is left out. The size of the change is found with all others anywhere in
    their box.
    """
    scores, gram, free = fit.scores, fit.curvature, np.flatnonzero(fit.is_free)
    prior = 3.0 / np.maximum(0.5 * (fit.high - fit.low), 1e-30) ** 2
    inverse = np.linalg.pinv((gram.sum(axis=0) + np.diag(prior))[np.ix_(free, free)])
    B = len(scores)
    found: list[tuple[str, int, Array, float, float]] = []
    known: list[float] = []
    for name, m in some.items():
        for j in asked:
            h = gram[:, j, j]
            by = m - float(m @ h / h.sum())
            mixed = by @ gram[:, j, free]
            w = inverse @ mixed
            information = float(by**2 @ h - mixed @ w)
            if information <= 1e-6 * float(by**2 @ h):
                continue
            u = by * scores[:, j] - scores[:, free] @ w
            scatter = float(B * u.var(ddof=1))
            found.append((name, j, by, float(u.sum()) / information, scatter / information))
            known.append(information)
    over, count = moderated(
        np.array([x[-1] for x in found]), np.full(len(found), B - 1.0), float(PARTS * B - 1)
    )
    for (name, j, by, value, _), one, many, about in zip(found, over, count, known, strict=True):
        t = abs(value) * np.sqrt(about / max(one, 1e-300))
        p = float(2.0 * student.sf(t, many))
        low, high = REACH * problem.table.plausible[j]
        limit, se = EITHER_SIDE * _may_be(problem, j), float(np.sqrt(max(one, 0.0) / about))
        rare = chance_of_large(limit, se, float(many), 0.0)
        own = fit.beside(j, by, float(low), float(high)) if p < FALSE_SHARE else value
        yield ScoreTest(name, j, p, own, rare)


def _may_be(problem: Problem, j: int) -> float:
    """Error that a correct file may have, including that of the equations."""
    return float(problem.table.tolerance[j] + SD_95 * problem.table.model_error[j])


def amount(key: str, x: float) -> str:
    """Text of a number of the model file in a familiar unit."""
    unit = PARAMETERS[key].unit
    if unit.startswith("rad"):
        x, unit = float(np.degrees(x)), f"deg{unit.removeprefix('rad')}"
    elif unit in ("", "1"):
        x, unit = 100.0 * x, "%"
    return f"{x:.2g} {unit}"


def _question(
    problem: Problem, key: str, kind: str, p: float, size: float, text: str, rare: float = 1.0
) -> Question:
    signal = first_signal(problem.table, [key])
    text = f"{text} ({size:.1f} times the limit of a correct file)"
    return Question(p, size > 1.0, Structure(signal, kind, size, text, key), rare)


def conditions(problem: Problem, state: State) -> dict[str, Array]:
    """(B,) by name: conditions in which segments differ."""
    table = problem.table
    rows = [
        _of_segment(state.forwards[i], state.drives[i], float(start), table.seconds)
        for i, start in zip(table.drive.tolist(), table.start_s, strict=True)
    ]
    names = ("slow and fast", "smooth and shaken", "straight and winding", "even and braking")
    return dict(zip(names, np.array(rows).T, strict=True))


def _of_segment(
    f: Forward, drive: DriveSignals, start: float, seconds: float
) -> tuple[float, float, float, float]:
    """Mean speed, mean square of the accelerometer's differences, rms of speed times yaw rate, rms
    of the speed's slope."""
    inside = (f.t >= start - 0.5 * STEP_S) & (f.t < start + seconds - 0.5 * STEP_S)
    v = np.interp(f.t[inside], f.knots, np.abs(drive.knots.values))
    accel = drive.channels["accel"]
    first, last = np.searchsorted(accel.t, [start, start + seconds])
    steps = np.diff(accel.values[first:last], axis=0)
    turning = f.yaw_rate()[inside] if f.has_turning else np.zeros_like(v)
    return (
        float(v.mean()), float(np.mean(steps**2)), float(np.sqrt(np.mean((v * turning) ** 2))),
        float(np.std(np.gradient(v, STEP_S))),
    )  # fmt: skip
