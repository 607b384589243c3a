"""Zeros and gains that are not the same all along: from piece to piece, and by condition.

A parameter of the model file is one number. Where the best number of a segment goes with that of
its neighbours, or with how fast, how shaken or how hard the vehicle is driven, something acts that
no parameter describes. Every zero and gain is asked, whether it was found to be off or not.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from scipy.stats import t as student

from imucald.diagnosis.causes import PARAMETERS
from imucald.diagnosis.chance import Question
from imucald.diagnosis.forward import Forward
from imucald.diagnosis.outcome import signals_of
from imucald.diagnosis.result import DIFFERS, WANDERS, Structure
from imucald.diagnosis.score import Hypothesis, Problem, box_fit
from imucald.diagnosis.signals import STEP_S, Array, DriveSignals
from imucald.diagnosis.state import State
from imucald.mount.mount_words import SD_95

ASKED = ("bias", "scale", "offset")
"""Endings of what every sensor has. Delays, lever arm and springs also take what the equations of
the tyres err by, which goes with the speed in measured drives without an effect."""
LAGS = 3
"""Neighbouring segments, a minute and a half: longer than a manoeuvre."""
DRAWS, AT_ONCE = 20000, 1000
LEAST_BLOCKS = 12
EVENLY = 3.0**-0.5
"""Deviation of what goes anywhere within its tolerance, over the tolerance."""
EITHER_SIDE = 2.0
"""Tolerances from one end of what a correct file may be to the other."""


def unstable(problem: Problem, state: State) -> list[Question]:
    """Zeros and gains that wander from piece to piece, or differ between conditions."""
    if problem.table.blocks < LEAST_BLOCKS:
        return []
    drift = next((t.hypothesis for t in state.named if t.hypothesis.pattern is not None), None)
    scores, gram = _scores(problem, drift)
    asked = [j for j, key in enumerate(problem.table.keys)
             if any(part in ASKED for part in key.split(".")) and gram[:, j, j].any()]  # fmt: skip
    return [
        *_wandering(problem, scores, gram, asked),
        *_conditional(problem, scores, gram, asked, conditions(problem, state)),
    ]


def _scores(problem: Problem, drift: Hypothesis | None) -> tuple[Array, Array]:
    """Slopes (B, P) of each segment's loss where all are fitted, and curvatures (B, P, P).

    drift: of what was named and has no place in the model file; it is fitted beside.
    """
    gram, low, high = problem.widened(drift)
    total = gram.sum(axis=0)
    x = box_fit(total[1:, 1:], total[1:, 0], low, high)
    own = len(problem.table.keys)
    scores = gram[:, 1:, 0] - gram[:, 1:, 1:] @ x
    return scores[:, :own], problem.table.gram[:, 1:, 1:]


def _wandering(
    problem: Problem, scores: Array, gram: Array, asked: list[int]
) -> Iterator[Question]:
    """Neighbouring segments that agree on a departure which the whole does not show.

    Of scores s_b with information h_b, s_b s_(b+l) has the expectation h_b h_(b+l) sigma^2, where
    sigma is by how much the parameter wanders. Chance: the same segments in any order.
    """
    h = np.stack([gram[:, j, j] for j in asked], axis=1)
    s = scores[:, asked]
    s = s - h * (s.sum(axis=0) / h.sum(axis=0))
    got, rng = _shared(s), np.random.default_rng(0)
    beaten = np.zeros(len(asked))
    for _ in range(DRAWS // AT_ONCE):
        order = np.argsort(rng.random((AT_ONCE, len(s))), axis=1)
        beaten += (_shared(s[order]) >= got).sum(axis=0)
    sd = np.sqrt(np.maximum(got, 0.0) / np.maximum(_shared(h), 1e-300))
    for k, j in enumerate(asked):
        key, tau = problem.table.keys[j], _may_be(problem, j)
        p = float((1.0 + beaten[k]) / (DRAWS + 1.0))
        text = f"{key} wanders by {_amount(key, float(sd[k]))} from piece to piece of the drive"
        yield _question(problem, key, WANDERS, p, float(sd[k]) / (EVENLY * tau), text)


def _shared(s: Array) -> Array:
    """Sum over neighbours of their products; segments last but one: (..., B, K) to (..., K)."""
    made = np.zeros((*s.shape[:-2], s.shape[-1]))
    for lag in range(1, LAGS + 1):
        made += np.einsum("...bk,...bk->...k", s[..., lag:, :], s[..., :-lag, :])
    return made


def _conditional(
    problem: Problem, scores: Array, gram: Array, asked: list[int], some: Mapping[str, Array]
) -> Iterator[Question]:
    """A zero or gain that is another where a condition is high: a column times the condition is
    fitted beside all others (score test, deviation between segments)."""
    prior = 3.0 / np.maximum(0.5 * (problem.high - problem.low), 1e-30) ** 2
    inverse = np.linalg.pinv(gram.sum(axis=0) + np.diag(prior))
    B = len(scores)
    for name, c in some.items():
        low, high = np.quantile(c, [0.05, 0.95])
        if not high > low:
            continue
        m = np.clip((c - low) / (high - low), 0.0, 1.0)
        for j in asked:
            h = gram[:, j, j]
            by = m - float(m @ h / h.sum())
            w = inverse @ (by @ gram[:, j, :])
            information = float(by**2 @ h - (by @ gram[:, j, :]) @ w)
            if information <= 1e-6 * float(by**2 @ h):
                continue
            u = by * scores[:, j] - scores @ w
            # A sum over its own root of squares never exceeds the root of their number.
            ratio = float(u.sum() ** 2 / max(float(u @ u), 1e-300))
            t = np.sqrt(ratio * (B - 1) / max(B - ratio, 1e-9))
            key, value = problem.table.keys[j], float(u.sum() / information)
            size = abs(value) / (EITHER_SIDE * _may_be(problem, j))
            text = f"{key} differs by {_amount(key, value)} between {name} segments"
            yield _question(problem, key, DIFFERS, float(2.0 * student.sf(t, B - 1)), size, text)


def _may_be(problem: Problem, j: int) -> float:
    """By how much a correct file may be wrong, with what the equations err by."""
    return float(problem.table.tolerance[j] + SD_95 * problem.table.model_error[j])


def _amount(key: str, x: float) -> str:
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
