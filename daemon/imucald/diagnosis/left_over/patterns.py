"""Test a residual for a nonlinear dependence on its own signal: bent, one-sided, or with memory.

If a model is linear in its errors, its residual does not depend on the level, the direction or the
last large value of a signal, for any parameters. Such a residual therefore has no cause in the
catalogue.

Everything linear in the signal is fitted together with a shape (as in the test of Lee, White and
Granger 1993). Otherwise a gain that is not fully removed would look like memory, because the last
large value predicts the present value.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import idct

from imucald.core.arrays import Array
from imucald.core.samples import GRAVITY
from imucald.diagnosis.causes import MODEL_ERROR, PARAMETERS
from imucald.diagnosis.equations.forward import UNITS, Forward
from imucald.diagnosis.fit.blocks import LEAST_SHARE, cosine, noise_weights, without_tilt
from imucald.diagnosis.fit.chance import Question, chance_of_both, chance_of_large
from imucald.diagnosis.fit.sandwich import scatters, variances
from imucald.diagnosis.fit.score import Problem, without_best
from imucald.diagnosis.left_over.conditions import shaken
from imucald.diagnosis.result import GOES_WITH_LEVEL, GOES_WITH_SHAKING, Structure
from imucald.diagnosis.search.trials import SINGLE_NATS
from imucald.diagnosis.signals import STEP_S
from imucald.mount.mount_words import SD_95

ASKED = ("accel_x", "accel_y", "gyro_z", "lateral_accel", "longitudinal_accel")
"""Equations in which another sensor predicts the signal."""
ZERO: Mapping[str, str] = {"gyro_z": "gyro.bias.z", "accel_x": "accel.bias.x",
                           "accel_y": "accel.bias.y"}  # fmt: skip
"""Zero errors that a correct file may have; smaller effects are not reported."""
GAIN: Mapping[str, str] = {
    "accel_x": "speed.scale", "accel_y": "gyro.scale.2", "gyro_z": "gyro.scale.2",
    "lateral_accel": "lateral_accel.scale", "longitudinal_accel": "longitudinal_accel.scale",
}  # fmt: skip
"""Gains whose tolerance limits the effect, including the error of the equations."""
GAINS = ("bent", "one-sided", "steeper")
"""Shapes that are a value-dependent gain; they are compared with the tolerance of a gain."""
LINEAR = 3
"""Number of columns that are linear in the signal: value, first and second derivative, for a gain,
a delay and a filter (the first three terms of a transfer function's Taylor series about frequency
0)."""
LEAST_BLOCKS = 8
CLUSTER_S = 5.0
"""Length of the parts of a block whose scatter is used next to that of blocks: as long as a
manoeuvre. Whitened residuals are independent after half the period of the band's upper end, a
second or two."""
LARGE = (0.5, 1.0, 2.0)
"""Levels, in multiples of the rms, above which a value may leave an after-effect. They are octaves,
so one lies within a factor of 1.4 of any true level; the sign of the last large value is then
mostly the same."""
SHAKEN_S = (1.0, 3.0, 10.0)
"""Time constants from the resolution of the grid up to those that a block's tilt absorbs."""
LATE = "late"
TURNING = "turning"
"""Shape of a speed error equal to a length times the absolute yaw rate (RESET with another input's
even part; Ramsey 1969). A point left or right of the vehicle's middle has an error by
the signed yaw rate, which is odd."""
BESIDE_M = PARAMETERS["mount.lever_arm_m.1"].tolerance
"""Allowed lateral offset, in a correct file, of the point to which the speed belongs [m]."""
DELAY_S = dict.fromkeys(ASKED, PARAMETERS["accel.delay_s"].tolerance) | {
    "accel_x": PARAMETERS["speed.delay_s"].tolerance
}
"""Allowed delay of a signal of the equation in a correct file [s]."""
SHAPES = {
    "bent": "has a smaller slope for large values than for small ones",
    "one-sided": "differs between positive and negative values",
    "steeper": "grows faster than the value",
    "by direction": "depends on whether the value rises or falls",
    LATE: "has more delay on one side than on the other",
    **{f"memory {x:g}": "keeps the sign of the last large value" for x in LARGE},
    **{
        f"shaken {x:g}": f"follows how much the sensor was shaken in the last {x:g} s"
        for x in SHAKEN_S
    },
    TURNING: "follows how much the vehicle turns, to either side",
}
SPEED_S = "accel_x"
"""The equation of the speed's slope; its yaw rate comes from another sensor."""


@dataclass(frozen=True)
class ShapeRows:
    """Blocks of one equation, transformed. Residual (B, K); shapes (B, K, LINEAR + k): the value,
    its first and second derivative, and k more; tilt (B, K, Z)."""

    y: Array
    X: Array
    tilt: Array
    rows: int
    """Samples in each block."""


@dataclass(frozen=True)
class Grams:
    """Gram matrices of one equation, whitened, with the tilt projected out; residual first."""

    parts: Array
    """(B, C, P, P) of each block's parts, one or more."""
    squares: Array
    """(B, P) mean squares of the columns, in their units."""

    @property
    def blocks(self) -> Array:
        """(B, P, P) Gram matrices of whole blocks."""
        return np.asarray(self.parts.sum(axis=1))


def patterns(problem: Problem, forwards: Sequence[Forward]) -> list[Question]:
    """Test for residuals that depend nonlinearly on their own signal.

    Each shape is fitted together with the signal, its first and second derivative, and a tilt of
    each block. An effect is large if it exceeds the zero error or the delay that a correct file may
    have, and does not come from a single block.
    """
    changes = problem.fitted_changes()
    parts: dict[str, list[ShapeRows]] = {}
    for f in forwards:
        for name, rows in _of_drive(f, changes, problem.table.top_hz):
            parts.setdefault(name, []).append(rows)
    grams = {name: _gram(own) for name, own in parts.items()}
    return [
        question
        for name, gram in grams.items()
        if len(gram.parts) >= LEAST_BLOCKS
        for question in _asked(name, gram)
    ]


def _of_drive(
    f: Forward, changes: Mapping[str, float], top_hz: Mapping[str, float]
) -> list[tuple[str, ShapeRows]]:
    masks, residuals = f.usable(), f.residuals(changes)
    measured = f.measured()
    shaking = [shaken(f, seconds) for seconds in SHAKEN_S]
    turning = _turning(f, top_hz)
    made = []
    for name in ASKED:
        if name not in residuals.of or name not in measured:
            continue
        good = masks[name].mean(axis=1) >= LEAST_SHARE
        count = max(1, int(2.0 * f.rows * STEP_S * top_hz[name]))
        own = measured[name] - np.median(measured[name])
        beside = turning if name == SPEED_S else np.zeros(len(f.t))
        columns = [*_shapes(own, top_hz[name]).T, *shaking, beside]
        shapes = [x.reshape(f.blocks, f.rows) for x in columns]
        tilt = residuals.tilt.get(name, (np.ones((f.blocks, f.rows)),))
        y, X, Z = (
            np.stack([cosine(x, masks[name], count) for x in some], axis=2)[good]
            for some in ([residuals.of[name]], shapes, tilt)
        )
        made.append((name, ShapeRows(y[:, :, 0], X, Z, f.rows)))
    return made


def _gram(parts: Sequence[ShapeRows]) -> Grams:
    A = np.concatenate([np.concatenate([p.y[:, :, None], p.X], axis=2) for p in parts])
    Z = np.concatenate([p.tilt for p in parts])
    A = without_tilt(A, Z)
    squares = np.sum(A**2, axis=1) / parts[0].rows
    # What the linear columns leave over counts as noise.
    linear = A[:, :, : 1 + LINEAR]
    line = _solved(np.einsum("bki,bkj->ij", linear, linear))
    left = A[:, :, 0] - linear[:, :, 1:] @ line
    w = noise_weights(left, np.ones(len(A), dtype=bool))[:, :, None]
    A = without_tilt(A * w, Z * w)
    return Grams(_in_time(A, parts[0].rows * STEP_S), squares)


def _in_time(A: Array, seconds: float) -> Array:
    """Gram matrices (B, C, P, P) of the parts of transformed blocks (B, K, P), one after another
    (Parseval: they add up to the block's)."""
    count = max(1, min(round(seconds / CLUSTER_S), A.shape[1]))
    cut = np.array_split(idct(A, type=2, axis=1, norm="ortho"), count, axis=1)
    return np.stack([np.swapaxes(x, 1, 2) @ x for x in cut], axis=1)


def _shapes(x: Array, top_hz: float) -> Array:
    """(N, LINEAR + k): value, first and second derivative of the signal (N,), then the tested
    shapes, corrected for the effect of noise. Sizes are relative to the signal's rms. [unit,
    unit/s, unit/s^2]"""
    smooth = _smooth(x, top_hz)
    size = max(float(np.sqrt(np.mean(smooth**2))), 1e-12)
    z = smooth / size
    slope = np.gradient(z, STEP_S)
    quick = np.tanh(slope / max(float(np.std(slope)), 1e-12))
    slope *= size
    rows = np.arange(len(z))
    last = [np.sign(z[np.maximum.accumulate(np.where(np.abs(z) > n, rows, 0))]) for n in LARGE]
    shapes = [z / (1.0 + np.abs(z)), z**2, z * np.abs(z), quick, slope * np.sign(z), *last]
    return np.column_stack([x, np.gradient(x, STEP_S), _bend(x), *shapes])


def _bend(x: Array) -> Array:
    """(N,) second difference, which works up to half the sample rate."""
    padded = np.pad(x, 1, mode="edge")
    return np.asarray(np.diff(padded, 2) / STEP_S**2)


def _smooth(x: Array, top_hz: float) -> Array:
    n = max(1, round(0.5 / (top_hz * STEP_S)))
    return np.asarray(np.convolve(x, np.ones(n) / n, "same"))


def _turning(f: Forward, top_hz: Mapping[str, float]) -> Array:
    """(N,) derivative of the absolute yaw rate [rad/s^2]; zero without a yaw rate."""
    if not f.has_turning or SPEED_S not in top_hz:
        return np.zeros(len(f.t))
    return np.asarray(np.gradient(np.abs(_smooth(f.yaw_rate(), top_hz[SPEED_S])), STEP_S))


def _asked(name: str, gram: Grams) -> Iterator[Question]:
    squares = gram.squares
    for k, shape in enumerate(SHAPES):
        at = 1 + LINEAR + k
        if not squares[:, at].any():
            continue  # not tested for this equation
        index = [*range(1 + LINEAR), at]
        value, sigma, p, gain, free = _fit(gram.parts[:, :, index][:, :, :, index])
        rms = float(np.sqrt(squares[:, at].mean()))
        kind, limit, unit = GOES_WITH_LEVEL, _least(name), rms
        if shape == LATE:
            # One side is late by `value` seconds, the other is early by as much.
            limit, unit = DELAY_S[name], 1.0
        elif shape == TURNING:
            limit, unit = BESIDE_M, 1.0
        elif shape.startswith("memory"):
            # The effect is a zero error with either sign.
            unit = 1.0
        elif shape.startswith("shaken"):
            # The effect is compared with the whole tolerance range of a zero.
            kind, limit, unit = GOES_WITH_SHAKING, 2.0 * _least(name), 1.0
        elif shape in GAINS:
            limit = _gain(name) * float(np.sqrt(squares[:, 1].mean()))
        is_large = abs(value) * unit > limit
        size = abs(value) * (rms if shape in (LATE, TURNING) else unit)
        text = f"the residual {SHAPES[shape]}: {size:.2g} {UNITS[name]}, {sigma:.1f} deviations"
        rare = chance_of_large(limit, abs(value) * unit / max(sigma, 1e-300), free, 0.0)
        structure = Structure(name, kind, sigma, text)
        yield Question(p, gain > SINGLE_NATS and is_large, structure, rare)


def _least(name: str) -> float:
    row = PARAMETERS.get(ZERO.get(name, ""))
    return row.tolerance if row is not None else 0.003 * GRAVITY


def _gain(name: str) -> float:
    """Tolerance of the gain, as a share of the value."""
    key = GAIN[name]
    base = next(k for k in MODEL_ERROR if key.startswith(k))
    return PARAMETERS[key].tolerance + SD_95 * MODEL_ERROR[base]


def _fit(parts: Array) -> tuple[float, float, float, float, float]:
    """Result for the last column, fitted with the others: value, its size in standard deviations,
    its chance, nats on blocks that its fit did not use, and the degrees of freedom of its error.

    parts: (B, C, 1 + P, 1 + P), residual first.

    It must exceed chance by the scatter of the parts (Student, with their effective number) and by
    the noise of all rows (normal). Each measure uses its own distribution, so a large deviation
    from the rows is not judged with the few degrees of freedom of the parts.
    """
    gram = parts.sum(axis=1)
    total = gram.sum(axis=0)
    value, whole = _solved(total), total[1:, 1:]
    fine = parts.reshape(-1, *parts.shape[2:])
    inverse = np.linalg.pinv(whole)
    blocks = max(
        float(variances(inverse, way)[-1])
        for some in (gram, fine)
        for way in scatters(some[:, 1:, 0] - some[:, 1:, 1:] @ value, len(value))
    )
    rows = float(variances(inverse, whole)[-1])
    if min(blocks, rows) <= 0.0:  # no information is left (rounding)
        return float(value[-1]), 0.0, 1.0, 0.0, 1.0
    by_blocks, by_rows = abs(value[-1]) / np.sqrt(blocks), abs(value[-1]) / np.sqrt(rows)
    freedom = _effective(fine[:, 1:, 1:], inverse[-1]) - 1.0
    p = chance_of_both(float(by_blocks), freedom, float(by_rows))
    rest = total - gram
    gain = _losses(gram[:, :-1, :-1], _solved(rest[:, :-1, :-1])) - _losses(gram, _solved(rest))
    return float(value[-1]), float(min(by_blocks, by_rows)), p, without_best(gain), freedom


def _effective(inner: Array, row: Array) -> float:
    """Effective number of parts for a value: their number, or fewer if they carry unequal
    information (effective number of clusters; Carter, Schnepel and Steigerwald 2017); more than
    one.

    inner: (C, P, P) of the columns. row: (P,) of the inverse Hessian.
    """
    share = np.einsum("i,cij,j->c", row, inner, row)
    return max(float(share.sum() ** 2 / max(float(share @ share), 1e-300)), 1.0 + 1e-6)


def _solved(gram: Array) -> Array:
    """(..., P) least squares of Gram matrices (..., 1 + P, 1 + P), residual first."""
    inner, slope = gram[..., 1:, 1:], gram[..., 1:, :1]
    least = np.finfo(float).eps * inner.shape[-1]
    return np.asarray((np.linalg.pinv(inner, rcond=least, hermitian=True) @ slope)[..., 0])


def _losses(gram: Array, x: Array) -> Array:
    """(B,) half the sum of squares that x (B, P) leaves in blocks (B, 1 + P, 1 + P)."""
    z = np.concatenate([np.ones((len(x), 1)), -x], axis=1)[:, :, None]
    return np.asarray(0.5 * (np.swapaxes(z, 1, 2) @ gram @ z)[:, 0, 0])
