"""Linearises the forward models of all drives at one point, into whitened normal equations."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucald.core.rotations import rotation_from_vector
from imucald.diagnosis.cause import Parameter
from imucald.diagnosis.causes import mount_rotation, mount_shift
from imucald.diagnosis.evidence import Evidence
from imucald.diagnosis.forward import Forward
from imucald.diagnosis.grid import Array
from imucald.diagnosis.spectra import (
    BLOCK_S,
    ERROR_OF_LEAN,
    ERROR_STEADY,
    Blocks,
    Complex,
    Noise,
    bands,
    cross_spectra,
    loudness,
    model_error,
    noise_of,
    normal_equations,
    transform,
    weighted,
)

LEANING = ("gyro_x", "gyro_y")
"""Signals that only the body's lean moves."""
GYRO_TIMING = ("gyro.delay_s", "_lowpass.gyro")
"""Where the vehicle has a yaw rate of its own, the rates tell the gyroscope's timing. Through the
lever arm it moves the forces as well, but road that shakes both would be taken for it."""
HEAVE_FROM_HZ, HEAVE = 0.6, 30.0
"""From here on the vertical force is the road's, and in step with the body's pitch: so much more
noise."""
NOISE_ROUNDS = 2
"""The noise is what the fit of all parameters leaves; it weighs that fit, so: twice."""


@dataclass(frozen=True)
class Linearised:
    """All drives at one point of the parameters."""

    parameters: tuple[Parameter, ...]
    values: dict[str, float]
    """The point: total values."""
    evidence: Evidence
    noise: Noise
    columns: Complex
    """(B, F, C, P) derivatives, the drives' stretches one after another."""
    residual: Complex
    """(B, F, C) measured minus predicted."""
    present: NDArray[np.bool_]
    """(B, C)"""

    @property
    def flat(self) -> Complex:
        """Columns as (B F C, P)."""
        return self.columns.reshape(-1, self.columns.shape[-1])

    def at(self, residuals: Sequence[Complex]) -> tuple[Array, float]:
        """Score (P,) and square for other residuals (per drive), on the same columns and noise."""
        whole = np.concatenate(residuals)
        weighed = weighted(whole, self.present, self.noise)
        score = np.real(weighed.ravel().conj() @ self.flat)
        square = float(np.real(np.vdot(weighed, whole)))
        return np.asarray(score, dtype=float), square

    def density(self, keys: Sequence[str]) -> float:
        """Log evidence of some keys with the noise that their own fit leaves, paid for.

        What the model cannot promise is not counted: it would be paid for by what it explains.
        """
        left = self.residual - self.columns @ self.evidence.fit(keys).x.astype(np.float32)
        loud = self.noise.loud
        noise = noise_of(left, self.present, loud, np.zeros_like(loud))
        whole = Blocks(self.columns, self.present, np.zeros(0))
        normal = normal_equations(whole, self.residual, noise)
        evidence = Evidence(self.parameters, normal, self.evidence.shift)
        return evidence.fit(keys).log_evidence - noise.volume(self.present, self.residual.shape[1])

    def quietness_of(self, residuals: Sequence[Complex]) -> float:
        """Log determinant of other residuals' spectra (per drive), means left out."""
        whole = np.concatenate(residuals)
        noise = cross_spectra(whole, self.present)
        sizes = [band.stop - band.start for band in bands(whole.shape[1])]
        dets = [float(np.linalg.slogdet(S)[1]) for S in noise]
        return float(np.dot(sizes[1:], dets[1:]))


def residual_blocks(forward: Forward, values: Mapping[str, float]) -> Complex:
    """Transformed residual (B, F, C) of a drive at some values."""
    return residual_stretches(forward, values).values[..., 0]


def residual_stretches(forward: Forward, values: Mapping[str, float]) -> Blocks:
    """The same (B, F, C, 1), with where each signal is present (B, C)."""
    left = _in_vehicle_axes(forward, forward.measured - forward.predict(values), values)
    return transform(left[None], forward.usable, forward.track.top_hz)


def _in_vehicle_axes(forward: Forward, x: Array, values: Mapping[str, float]) -> Array:
    """Signals (..., C, N) from the axes of the model's mount into those of the fitted one.

    Body and road shake the sensor in the vehicle's axes: only there is the noise of all stretches
    the same, and that of a quiet axis free of its neighbour's.
    """
    turn = rotation_from_vector([values.get(key, 0.0) for key in mount_rotation.KEYS])
    back = rotation_from_vector([values.get(key, 0.0) for key in mount_shift.KEYS])
    after = forward.track.t >= values.get(mount_shift.TIME, math.inf)
    for kind in ("accel", "gyro"):
        rows = [i for i, name in enumerate(forward.names) if name[:-2] == kind]
        if len(rows) < 3:
            continue
        triad = x[..., rows, :]
        triad[..., after] = back @ triad[..., after]
        x[..., rows, :] = turn @ triad
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
        noise = _noise_left(forwards[0].names, parameters, shift, columns, residual, predicted)
    else:
        columns = Blocks(near.columns.copy(), present, np.zeros(0))
        columns.values[..., taken] = whole[..., :-2]
        noise = near.noise
    normal = normal_equations(columns, residual, noise)
    return Linearised(
        tuple(parameters),
        dict(values),
        Evidence(parameters, normal, shift),
        noise,
        columns.values,
        residual,
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
    forces = [i for i, name in enumerate(forward.names) if name.startswith("accel_")]
    for i, p in enumerate(parameters):
        moved = dict(values)
        moved[p.key] += p.step
        stack[i] = (forward.predict(moved) - predicted) / p.step
        if p.key in GYRO_TIMING and "yaw_rate" in forward.track.scalars:
            stack[i, forces] = 0.0
    stack = _in_vehicle_axes(forward, stack, values)
    return transform(stack, forward.usable, forward.track.top_hz)


def _noise_left(
    names: Sequence[str],
    parameters: Sequence[Parameter],
    shift: Array,
    columns: Blocks,
    residual: Complex,
    predicted: Complex,
) -> Noise:
    """Noise of what the fit of all parameters leaves, and the forward model's error."""
    present = columns.present
    keys = [p.key for p in parameters]
    steady = np.array([ERROR_OF_LEAN if n in LEANING else ERROR_STEADY for n in names])
    error = model_error(predicted, steady)
    if "accel_z" in names:
        low = np.array([band.start for band in bands(residual.shape[1])]) / BLOCK_S
        heave, z = low >= HEAVE_FROM_HZ, names.index("accel_z")
    loud = np.ones((len(present), len(bands(residual.shape[1])), present.shape[1]))
    left = residual
    for _ in range(NOISE_ROUNDS):
        S = cross_spectra(left, present, loud, taken=10.0)
        if "accel_z" in names:
            own = np.sqrt(np.real(S[heave, z, z]))
            error[:, heave, z] = HEAVE * own * loud[:, heave, z]
        normal = normal_equations(columns, residual, Noise(S, loud, error))
        x = Evidence(parameters, normal, shift).fit(keys).x
        left = residual - columns.values @ x.astype(np.float32)
        loud = loudness(left, present, S)
    return Noise(cross_spectra(left, present, loud, taken=10.0), loud, error)
