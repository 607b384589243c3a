"""What is there to be seen: the change that an effect makes, against the noise it stands in.

The effect is put in by the judge, so the residual with it less the residual without it is known.
A filter made of that difference is the best that any test can do (matched filter); its output over
its own deviation is *ideal*. What a catalogue of wrong parameters and the tilts of the segments
could take of the difference is taken off first. None of the diagnosis' own tests is asked here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from imucald.core.samples import Samples
from imucald.diagnosis.cause_keys import tolerance
from imucald.diagnosis.causes import PARAMETERS
from imucald.diagnosis.equations.forward import Forward
from imucald.diagnosis.fit.blocks import (
    BLOCK_S,
    EQUATIONS,
    FEW_S,
    LEAST_SHARE,
    MOVING_MPS,
    MOVING_SHARE,
    SHORT_BLOCK_S,
    _top_hz,
    cosine,
    noise_weights,
)
from imucald.diagnosis.signals import STEP_S, DriveSignals, drive_of
from imucald.model.model import VehicleModel

Array = NDArray[np.float64]
ERROR_RATE, POWER = 0.01, 0.8
FACTORS = (1.0, 1.5, 2.0, 3.0)
"""Of an effect's own size, tried one after another until it can be seen."""
PASSES = 2


@dataclass(frozen=True)
class Seen:
    """One equation. ideal: deviations of the matched filter; needed: those from which on a test
    that knows the equation and nothing of the effect's shape sees it."""

    equation: str
    ideal: float
    needed: float

    @property
    def ratio(self) -> float:
        """1: such a test sees it in four of five."""
        return self.ideal / self.needed


def needed_sd(coefficients: int, equations: int) -> float:
    """From how many deviations of the matched filter on the energy of an equation's coefficients
    exceeds chance (1 % shared over the equations) in four of five: chi-square, central and not
    (Urkowitz, Energy detection of unknown deterministic signals, 1967)."""
    alpha, beta = norm.isf(ERROR_RATE / equations), norm.ppf(POWER)
    energy = 0.0
    for _ in range(50):
        energy = alpha * np.sqrt(2.0 * coefficients)
        energy += beta * np.sqrt(2.0 * coefficients + 4.0 * energy)
    return float(np.sqrt(energy))


class Ideal:
    """Noise and columns of one piece as it is; asked of many effects."""

    def __init__(self, samples: Samples, model: VehicleModel) -> None:
        self.model, drive = model, drive_of(samples)
        seconds = BLOCK_S if drive.duration_s > FEW_S else SHORT_BLOCK_S
        self.rows = round(seconds / STEP_S)
        self.top = _tops(drive)
        f = Forward(drive, model, self.rows)
        base, masks = f.residuals({}), f.usable()
        v = np.interp(f.t, f.knots, np.abs(drive.knots.values)).reshape(f.blocks, f.rows)
        moves = (v > MOVING_MPS).mean(axis=1) >= MOVING_SHARE
        self.masks = masks
        self.good = {n: (masks[n].mean(axis=1) >= LEAST_SHARE) & moves for n in base.of}
        self.base = base.of
        self.tilt = {n: self._stack(n, z) for n, z in base.tilt.items()}
        y = {n: self._cosine(n, x) for n, x in base.of.items()}
        X = self._columns(f)
        nothing = {n: x[:, :, :0] for n, x in X.items()}
        self.weights = {n: np.ones_like(y[n]) for n in y}
        for columns in (nothing, *[X] * PASSES):
            left = {n: self._without(n, y[n], columns[n]) for n in y}
            self.weights = {n: noise_weights(left[n], self.good[n]) for n in y}
        self.X, self.left = X, {n: self._without(n, y[n], X[n]) for n in y}

    def of(self, changed: Samples) -> list[Seen]:
        """By equation, the clearest first. changed: the piece with an effect."""
        f = Forward(drive_of(changed), self.model, self.rows)
        new = f.residuals({}).of
        made = []
        for n, x in self.base.items():
            # An effect that loses the last frames can make the piece shorter by a block.
            both = min(len(x), len(new[n]))
            change = np.zeros_like(x)
            change[:both] = new[n][:both] - x[:both]
            d = self._without(n, self._cosine(n, change), self.X[n])
            d, r = d * self.weights[n], self.left[n] * self.weights[n]
            own = np.sum(d * d, axis=1)
            chance = np.sum((d * r).sum(axis=1) ** 2)
            size = float(own.sum() / np.sqrt(max(own.sum(), chance))) if own.any() else 0.0
            needed = needed_sd(int((self.weights[n] > 0.0).sum()), len(self.base))
            made.append(Seen(n, size, needed))
        return sorted(made, key=lambda s: -s.ratio)

    def _cosine(self, name: str, x: Array) -> Array:
        count = max(1, int(2.0 * self.rows * STEP_S * self.top[name]))
        return cosine(x, self.masks[name], count)

    def _stack(self, name: str, some: tuple[Array, ...]) -> Array:
        return np.stack([self._cosine(name, z) for z in some], axis=2)

    def _columns(self, f: Forward) -> dict[str, Array]:
        """(B, K, P) of each equation: what a parameter makes of it that is wrong by all that a
        vehicle or a sensor can have."""
        f.settle(f.tilts(f.residuals({}), self.masks), np.ones(f.blocks))
        settled = f.residuals({}, by_inertia=True).of
        made: dict[str, list[Array]] = {n: [] for n in self.base}
        for key, row in PARAMETERS.items():
            if not all(f.drive.has(n) for n in row.needs):
                continue
            step = tolerance(self.model, key) or row.tolerance
            moved = f.residuals({key: step}, by_inertia=True).of
            for n in self.base:
                change = (settled[n] - moved[n]) * max(map(abs, row.plausible)) / step
                if np.any(change):
                    made[n].append(self._cosine(n, change))
        return {
            n: np.stack(c, axis=2) if c else np.zeros((*self._cosine(n, self.base[n]).shape, 0))
            for n, c in made.items()
        }

    def _without(self, name: str, y: Array, X: Array) -> Array:
        """Rows (B, K) less the tilts of the segments and one fit of all columns, by weight."""
        w = getattr(self, "weights", {}).get(name, np.ones_like(y)) * self.good[name][:, None]
        A = np.concatenate([y[:, :, None], X], axis=2) * w[:, :, None]
        if name in self.tilt:
            Z = self.tilt[name] * w[:, :, None]
            inner = np.swapaxes(Z, 1, 2) @ Z
            inner = (
                inner + 1e-9 * np.eye(2) * (1.0 + np.trace(inner, axis1=1, axis2=2))[:, None, None]
            )
            A = A - Z @ np.linalg.solve(inner, np.swapaxes(Z, 1, 2) @ A)
        left: Array = A[:, :, 0]
        if X.shape[2]:
            flat = A.reshape(-1, A.shape[2])
            inner = flat[:, 1:].T @ flat[:, 1:] + np.eye(X.shape[2])
            x = np.linalg.solve(inner, flat[:, 1:].T @ flat[:, 0])
            left = left - A[:, :, 1:] @ x
        return np.asarray(np.divide(left, w, out=np.zeros_like(left), where=w > 0.0))


def _tops(drive: DriveSignals) -> Mapping[str, float]:
    return {name: _top_hz(drive, name) for name in EQUATIONS}
