"""Linearises the forward models of all drives at one point, into whitened normal equations."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucald.diagnosis.cause import Parameter
from imucald.diagnosis.causes import mount_shift
from imucald.diagnosis.evidence import Evidence
from imucald.diagnosis.forward import Forward
from imucald.diagnosis.grid import Array
from imucald.diagnosis.spectra import (
    ERROR_OF_LEAN,
    ERROR_STEADY,
    Blocks,
    Complex,
    bands,
    cross_spectra,
    loudness,
    normal_equations,
    transform,
    weighted,
    with_model_error,
)

LEANING = ("gyro_x", "gyro_y")
"""Signals that only the body's lean moves."""
NOISE_ROUNDS = 2
"""The noise is what the fit of all parameters leaves; it weighs that fit, so: twice."""


@dataclass(frozen=True)
class Linearised:
    """All drives at one point of the parameters."""

    parameters: tuple[Parameter, ...]
    values: dict[str, float]
    """The point: total values."""
    evidence: Evidence
    noise: Complex
    """(bands, C, C)"""
    columns: Complex
    """(B, F, C, P) derivatives, the drives' stretches one after another."""
    residual: Complex
    """(B, F, C) measured minus predicted."""

    loud: Array
    """(B, bands, C)"""
    present: NDArray[np.bool_]
    """(B, C)"""

    @property
    def flat(self) -> Complex:
        """Columns as (B F C, P)."""
        return self.columns.reshape(-1, self.columns.shape[-1])

    def at(self, residuals: Sequence[Complex]) -> tuple[Array, float]:
        """Score (P,) and square for other residuals (per drive), on the same columns and noise."""
        whole = np.concatenate(residuals)
        weighed = weighted(whole, self.present, self.noise, self.loud)
        score = np.real(weighed.ravel().conj() @ self.flat)
        square = float(np.real(np.vdot(weighed, whole)))
        return np.asarray(score, dtype=float), square

    def quietness(self) -> float:
        """Log determinant of the noise: smaller where more was explained."""
        sizes = [band.stop - band.start for band in bands(self.residual.shape[1])]
        dets = [float(np.linalg.slogdet(S)[1]) for S in self.noise]
        return float(np.dot(sizes, dets))

    def evidence_with(self, other: Linearised, base: Mapping[str, float]) -> Evidence:
        """Evidence around this point with another point's noise."""
        whole = Blocks(self.columns, self.present, np.zeros(0))
        normal = normal_equations(whole, self.residual, other.noise, other.loud)
        shift = np.array([self.values[p.key] - base[p.key] for p in self.parameters])
        return Evidence(self.parameters, normal, shift)


def residual_blocks(forward: Forward, values: Mapping[str, float]) -> Complex:
    """Transformed residual (B, F, C) of a drive at some values."""
    left = _unshifted(forward, forward.measured - forward.predict(values), values)
    return transform(left[None], forward.usable, forward.track.top_hz).values[..., 0]


def _unshifted(forward: Forward, x: Array, values: Mapping[str, float]) -> Array:
    """Signals (..., C, N) with what follows a shift of the mount in the axes of before it.

    Body and road shake the sensor in the vehicle's axes: only there is the noise of all stretches
    the same.
    """
    for kind in ("accel", "gyro"):
        rows = [i for i, name in enumerate(forward.names) if name[:-2] == kind]
        if len(rows) == 3 and any(values.get(key, 0.0) for key in mount_shift.KEYS):
            x[..., rows, :] = mount_shift.undone(x[..., rows, :], forward.track.t, values)
    return x


def linearise(
    forwards: Sequence[Forward],
    parameters: Sequence[Parameter],
    values: dict[str, float],
    base: Mapping[str, float],
    near: Linearised | None = None,
    moved: Collection[str] = (),
) -> Linearised:
    """Take derivatives at `values`, and the noise that is left when all parameters are free.

    near: a point not far off: only the derivatives of the keys in `moved` are taken anew, and the
    noise is that of the point. This is enough for a step on the way.
    """
    taken = [i for i, p in enumerate(parameters) if near is None or p.key in moved]
    parts = [_differentiated(f, [parameters[i] for i in taken], values) for f in forwards]
    present = np.concatenate([part.present for part in parts])
    whole = np.concatenate([part.values for part in parts])
    residual, predicted = np.ascontiguousarray(whole[..., -2]), whole[..., -1]
    shift = np.array([values[p.key] - base[p.key] for p in parameters])
    if near is None:
        columns = Blocks(whole[..., :-2], present, np.zeros(0))
        noise, loud = _noise_left(
            forwards[0].names, parameters, shift, columns, residual, predicted
        )
    else:
        columns = Blocks(near.columns.copy(), present, np.zeros(0))
        columns.values[..., taken] = whole[..., :-2]
        noise, loud = near.noise, near.loud
    normal = normal_equations(columns, residual, noise, loud)
    return Linearised(
        tuple(parameters),
        dict(values),
        Evidence(parameters, normal, shift),
        noise,
        columns.values,
        residual,
        loud,
        present,
    )


def _differentiated(
    forward: Forward, parameters: Sequence[Parameter], values: Mapping[str, float]
) -> Blocks:
    """One drive: derivatives, then residual and prediction, on the last axis."""
    predicted = forward.predict(values)
    stack = np.empty((len(parameters) + 2, *predicted.shape), dtype=np.float32)
    stack[-1] = predicted - predicted.mean(axis=1, keepdims=True)
    stack[-2] = forward.measured - predicted
    for i, p in enumerate(parameters):
        moved = dict(values)
        moved[p.key] += p.step
        stack[i] = (forward.predict(moved) - predicted) / p.step
    stack = _unshifted(forward, stack, values)
    return transform(stack, forward.usable, forward.track.top_hz)


def _noise_left(
    names: Sequence[str],
    parameters: Sequence[Parameter],
    shift: Array,
    columns: Blocks,
    residual: Complex,
    predicted: Complex,
) -> tuple[Complex, Array]:
    """Noise and loudness of what the fit of all parameters leaves."""
    present = columns.present
    keys = [p.key for p in parameters]
    steady = np.array([ERROR_OF_LEAN if n in LEANING else ERROR_STEADY for n in names])
    loud = np.ones((len(present), len(bands(residual.shape[1])), present.shape[1]))
    left = residual
    for _ in range(NOISE_ROUNDS):
        noise = cross_spectra(left, present, loud, taken=10.0)
        wide = with_model_error(loud, predicted, noise, steady)
        normal = normal_equations(columns, residual, noise, wide)
        x = Evidence(parameters, normal, shift).fit(keys).x
        left = residual - columns.values @ x.astype(np.float32)
        loud = loudness(left, present, noise)
    noise = cross_spectra(left, present, loud, taken=10.0)
    return noise, with_model_error(loud, predicted, noise, steady)
