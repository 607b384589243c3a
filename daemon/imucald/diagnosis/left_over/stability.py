"""Zeros and gains that are not the same all along: from piece to piece, and by condition.

A parameter of the model file is one number. Where the best number of a segment goes with that of
its neighbours, or with how fast, how shaken or how hard the vehicle is driven, something acts that
no parameter describes. Every zero and gain is asked, whether it was found to be off or not.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from imucald.diagnosis.causes import PARAMETERS
from imucald.diagnosis.equations.forward import Forward
from imucald.diagnosis.fit.blocks import Table
from imucald.diagnosis.fit.box import box_fit
from imucald.diagnosis.fit.chance import FALSE_SHARE, Question
from imucald.diagnosis.fit.score import REACH, Hypothesis, Problem
from imucald.diagnosis.outcome import signals_of
from imucald.diagnosis.result import DIFFERS, WANDERS, Structure
from imucald.diagnosis.search.state import State
from imucald.diagnosis.search.trials import on_table
from imucald.diagnosis.signals import STEP_S, Array, DriveSignals, Mask
from imucald.mount.mount_words import SD_95

ASKED = ("bias", "scale", "offset")
"""Endings of what every sensor has. Delays, lever arm and springs also take what the equations of
the tyres err by, which goes with the speed in measured drives without an effect."""
LAGS = (1, 2, 3)
"""Neighbouring segments, half a minute to a minute and a half: longer than a manoeuvre. How long
something lasts is not known: each is asked."""
LEAST_SIDE = 3
"""Segments on either side of a moment, at least."""
DRAWS, AT_ONCE = 20000, 1000
LEAST_BLOCKS = 8
EVENLY = 3.0**-0.5
"""Deviation of what goes anywhere within its tolerance, over the tolerance."""
EITHER_SIDE = 2.0
"""Tolerances from one end of what a correct file may be to the other."""
EDGE = 1e-6
"""Of a box's width that counts as its edge."""


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
        """drift: of what was named and has no place in the model file; it is fitted beside."""
        gram, low, high = problem.widened(drift)
        total = gram.sum(axis=0)
        return Fit(gram, low, high, box_fit(total[1:, 1:], total[1:, 0], low, high))

    @property
    def curvature(self) -> Array:
        """(B, Q, Q) of each segment's loss."""
        return self.gram[:, 1:, 1:]

    @property
    def scores(self) -> Array:
        """(B, Q) slopes of each segment's loss, downward."""
        return np.asarray(self.gram[:, 1:, 0] - self.curvature @ self.x)

    @property
    def is_free(self) -> Mask:
        """(Q,) what lies inside its box. Only of that the slopes add up to none."""
        edge = EDGE * (self.high - self.low)
        return np.asarray((self.x > self.low + edge) & (self.x < self.high - edge))

    def beside(self, j: int, by: Array, low: float, high: float) -> float:
        """By how much parameter j goes with `by` (B,), itself whatever it is and all others
        anywhere in their box. low, high: bounds of both."""
        total, cross = self.gram.sum(axis=0), by @ self.gram[:, j + 1]
        H = np.block([[total[1:, 1:], cross[1:, None]],
                      [cross[None, 1:], by**2 @ self.curvature[:, j, j]]])  # fmt: skip
        c = np.append(total[1:, 0], cross[0])
        lows, highs = np.append(self.low, low), np.append(self.high, high)
        lows[j], highs[j] = low, high
        return float(box_fit(H, c, lows, highs)[-1])


def unstable(problem: Problem, state: State) -> list[Question]:
    """Zeros and gains that wander from piece to piece, or differ between conditions."""
    if problem.table.blocks < LEAST_BLOCKS:
        return []
    fit = Fit.of(problem, drift_of(problem, state))
    asked = [j for j, key in enumerate(problem.table.keys)
             if any(part in ASKED for part in key.split("."))
             and fit.curvature[:, j, j].any()]  # fmt: skip
    return [
        *_wandering(problem, fit, asked),
        *_jumping(problem, fit, asked),
        *_conditional(problem, fit, asked, conditions(problem, state)),
    ]


def drift_of(problem: Problem, state: State) -> Hypothesis | None:
    """What was named and has no place in the model file."""
    drifts = (t.hypothesis for t in state.named if t.hypothesis.pattern is not None)
    return next((on_table(h, problem.table) for h in drifts), None)


def _wandering(problem: Problem, fit: Fit, asked: list[int]) -> Iterator[Question]:
    """Neighbouring segments that agree on a departure which the whole does not show.

    Of scores s_b with information h_b, s_b s_(b+l) has the expectation h_b h_(b+l) sigma^2, where
    sigma is by how much the parameter wanders. Chance: the same segments in any order.
    """
    h = np.stack([fit.curvature[:, j, j] for j in asked], axis=1)
    s = fit.scores[:, asked]
    s = s - h * (s.sum(axis=0) / h.sum(axis=0))
    got, rng = _shared(s), np.random.default_rng(0)
    beaten = np.zeros_like(got)
    for _ in range(DRAWS // AT_ONCE):
        order = np.argsort(rng.random((AT_ONCE, len(s))), axis=1)
        beaten += (_shared(s[order]) >= got[:, None]).sum(axis=1)
    sd = np.sqrt(np.maximum(got, 0.0) / np.maximum(_shared(h), 1e-300))
    for (i, k), size in np.ndenumerate(sd):
        key, tau = problem.table.keys[asked[k]], _may_be(problem, asked[k])
        p = float((1.0 + beaten[i, k]) / (DRAWS + 1.0))
        text = f"{key} wanders by {amount(key, float(size))} from piece to piece of the drive"
        yield _question(problem, key, WANDERS, p, float(size) / (EVENLY * tau), text)


def _shared(s: Array) -> Array:
    """Sum over neighbours up to each lag of their products; segments last but one: (..., B, K) to
    (lags, ..., K)."""
    parts = [np.einsum("...bk,...bk->...k", s[..., n:, :], s[..., :-n, :]) for n in LAGS]
    return np.cumsum(parts, axis=0)


def _jumping(problem: Problem, fit: Fit, asked: list[int]) -> Iterator[Question]:
    """A zero or gain that is another from some moment on; its chance is shared out over moments."""
    B = problem.table.blocks
    moments: dict[str, Array] = {
        str(k): (np.arange(B) >= k).astype(float) for k in range(LEAST_SIDE, B - LEAST_SIDE + 1)
    }
    best: dict[int, tuple[float, float, str]] = {}
    for name, j, p, value in _score_tests(problem, fit, asked, moments):
        if p < best.get(j, (2.0, 0.0, ""))[0]:
            best[j] = p, value, name
    for j, (p, value, name) in best.items():
        key = problem.table.keys[j]
        size = abs(value) / (EITHER_SIDE * _may_be(problem, j))
        text = (
            f"{key} is another by {amount(key, value)} from {moment(problem.table, int(name))} on"
        )
        yield _question(problem, key, WANDERS, min(p * len(moments), 1.0), size, text)


def moment(table: Table, segment: int) -> str:
    """When a segment begins; of several drives, in which."""
    at, drive = f"{table.start_s[segment]:.0f} s", int(table.drive[segment])
    return at if not table.drive.any() else f"{at} of drive {drive + 1}"


def _conditional(
    problem: Problem, fit: Fit, asked: list[int], some: Mapping[str, Array]
) -> Iterator[Question]:
    """A zero or gain that is another where a condition is high."""
    shares = {}
    for name, c in some.items():
        low, high = np.quantile(c, [0.05, 0.95])
        if high > low:
            shares[name] = np.clip((c - low) / (high - low), 0.0, 1.0)
    for name, j, p, value in _score_tests(problem, fit, asked, shares):
        key = problem.table.keys[j]
        size = abs(value) / (EITHER_SIDE * _may_be(problem, j))
        text = f"{key} differs by {amount(key, value)} between {name} segments"
        yield _question(problem, key, DIFFERS, p, size, text)


def _score_tests(
    problem: Problem, fit: Fit, asked: list[int], some: Mapping[str, Array]
) -> Iterator[tuple[str, int, float, float]]:
    """A column times a pattern over the segments, fitted beside all others (score test, deviation
    between segments): pattern's name, parameter, chance, by how much it is another.

    What is held at the edge of its box cannot take part of the pattern, and its slope, which does
    not vanish there, is no part of it. By how much: all others anywhere in their box.
    """
    scores, gram, free = fit.scores, fit.curvature, np.flatnonzero(fit.is_free)
    prior = 3.0 / np.maximum(0.5 * (fit.high - fit.low), 1e-30) ** 2
    inverse = np.linalg.pinv((gram.sum(axis=0) + np.diag(prior))[np.ix_(free, free)])
    B = len(scores)
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
            # A sum over its own root of squares never exceeds the root of their number.
            ratio = float(u.sum() ** 2 / max(float(u @ u), 1e-300))
            t = np.sqrt(ratio * (B - 1) / max(B - ratio, 1e-9))
            p, value = float(2.0 * student.sf(t, B - 1)), float(u.sum() / information)
            if p < FALSE_SHARE:
                low, high = REACH * problem.table.plausible[j]
                value = fit.beside(j, by, float(low), float(high))
            yield name, j, p, value


def _may_be(problem: Problem, j: int) -> float:
    """By how much a correct file may be wrong, with what the equations err by."""
    return float(problem.table.tolerance[j] + SD_95 * problem.table.model_error[j])


def amount(key: str, x: float) -> str:
    """A number of the model file in the unit in which people think."""
    unit = PARAMETERS[key].unit
    if unit.startswith("rad"):
        x, unit = float(np.degrees(x)), f"deg{unit.removeprefix('rad')}"
    elif unit in ("", "1"):
        x, unit = 100.0 * x, "%"
    return f"{x:.2g} {unit}"


def _question(problem: Problem, key: str, kind: str, p: float, size: float, text: str) -> Question:
    signal = (signals_of(problem.table, [key]) or ("accel_x",))[0]
    text = f"{text}, where a correct file's may not ({size:.1f} times what it may)"
    return Question(p, size > 1.0, Structure(signal, kind, size, text, key))


def conditions(problem: Problem, state: State) -> dict[str, Array]:
    """(B,) by name: what segments differ in."""
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
    """Mean speed, mean square of the accelerometer's steps, rms of speed times yaw rate, rms of the
    speed's slope."""
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
