"""The residuals of all drives after the search, in the forms that the rows of `table` need."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

from imucald.core.arrays import Array
from imucald.diagnosis.cause_keys import Changes
from imucald.diagnosis.equations.forward import Forward, Residuals
from imucald.diagnosis.fit.beside_file import Left, joined
from imucald.diagnosis.fit.blocks import LEAST_SHARE, MOVING_SHARE, Table
from imucald.diagnosis.fit.score import Hypothesis, Problem
from imucald.diagnosis.search.state import State
from imucald.diagnosis.search.trials import on_table
from imucald.diagnosis.signals import DRIVING_MPS, STANDING_MPS, STEP_S, Mask
from imucald.model.leaves import BANDS_HZ

Spectra = NDArray[np.complex128]
LEAST_SEGMENTS = 8
"""Smallest number of segments between which a question looks for differences or a common wave."""
DRIVEN = ("_winding", "_braking")
"""Names of the lateral and forward accelerations that the driver causes."""


class DriveResiduals(NamedTuple):
    """One drive. Arrays are (B, n): B blocks with n rows each."""

    forward: Forward
    speed: Array
    found: Residuals
    left: Mapping[str, Array]
    """Residual of each equation with the tilt of each block removed."""
    masks: Mapping[str, Mask]


def residuals_of(f: Forward, changes: Changes) -> DriveResiduals:
    """Return the residuals of a drive with a changed model file."""
    found, masks = f.residuals(changes), f.usable()
    speed = f.in_blocks(f.amount_of_speed())
    return DriveResiduals(f, speed, found, f.level(found, masks), masks)


@dataclass(frozen=True)
class Remains:
    """The state of the search at its end. drift: a named drift, which has no place in the model
    file and is therefore fitted here."""

    problem: Problem
    state: State
    drift: Hypothesis | None = None

    @staticmethod
    def of_state(state: State) -> Remains:
        """Return the residuals of a search."""
        problem = state.evaluated()
        drifts = (t.hypothesis for t in state.named if t.hypothesis.pattern is not None)
        return Remains(problem, state, next((on_table(h, problem.table) for h in drifts), None))

    @property
    def table(self) -> Table:
        """The table of blocks."""
        return self.problem.table

    @cached_property
    def z(self) -> Array:
        """Coefficients (B, P+1) that turn the rows of each segment into its residual, after a fit
        of all parameters in their box."""
        x, own = self.problem.fit(self.drift), len(self.table.keys)
        z = np.tile(np.concatenate([[1.0], -x[:own]]), (self.table.blocks, 1))
        if self.drift is not None and self.drift.pattern is not None:
            for key, slope in zip(self.drift.keys, x[own:], strict=True):
                z[:, self.table.keys.index(key) + 1] -= slope * self.drift.pattern
        return z

    @cached_property
    def drives(self) -> list[DriveResiduals]:
        """The residuals of each drive, with all parameters fitted in their box."""
        changes = self.problem.fitted_changes()
        return [residuals_of(f, changes) for f in self.state.forwards]

    @cached_property
    def by_band(self) -> dict[float, Left]:
        """By segment length [s] and equation: mean speed (B,) of each segment in motion, and its
        rms residual (B, bands) in the unit of the equation."""
        parts: dict[str, list[tuple[Array, Array]]] = {}
        for _, v, _, left, masks in self.drives:
            moving = (v > STANDING_MPS).mean(axis=1) >= MOVING_SHARE
            for name, y in left.items():
                good = moving & (masks[name].mean(axis=1) >= LEAST_SHARE)
                rms = rms_by_band(y[good], masks[name][good])
                parts.setdefault(name, []).append((v[good].mean(axis=1), rms))
        return {self.table.seconds: joined(parts)}

    @cached_property
    def spectra(self) -> Mapping[str, Spectra]:
        """Spectra (B blocks, F frequencies) of each equation's residual, in the residual's unit.

        The row of a block with too few samples or too little driving is NaN. The inputs of the
        vehicle's motion, `_steering`, `_turning` and `DRIVEN`, are included.
        """
        parts: dict[str, list[Spectra]] = {}
        for f, v, _, left, masks in self.drives:
            rows = {name: (y, masks[name]) for name, y in left.items()}
            # The product is used under two masks, because a segment may lack one of the equations.
            sideways = v * f.in_blocks(f.yaw_rate()) if f.has_turning else v
            if "yaw_rate" in left:
                steering = f.in_blocks(f.scalar("steering", {}))
                rows["_turning"] = sideways, masks["yaw_rate"]
                rows["_steering"] = steering, masks["yaw_rate"]
            if f.has_turning and "accel_x" in left:
                rows["_winding"] = sideways, masks["accel_x"]
                rows["_braking"] = np.gradient(v, STEP_S, axis=1), masks["accel_x"]
            # With this window, the squares of all bins add up to the mean square of a row.
            window = np.hanning(f.rows) * np.sqrt(2.0 / (0.375 * f.rows**2))
            for name, (y, mask) in rows.items():
                x = np.where(mask, y, 0.0)
                z = np.fft.rfft((x - x.mean(axis=1, keepdims=True)) * window, axis=1)
                good = (mask.mean(axis=1) > 0.6) & ((v > DRIVING_MPS).mean(axis=1) > 0.5)
                parts.setdefault(name, []).append(np.where(good[:, None], z, np.nan))
        return {name: np.concatenate(p) for name, p in parts.items()}


def rms_by_band(y: Array, mask: Mask) -> Array:
    """Return the rms (B, bands) of the present rows (B, n)."""
    n = y.shape[1]
    power = dct(np.where(mask, y, 0.0), type=2, axis=1, norm="ortho") ** 2
    hz = np.arange(n) / (2.0 * n * STEP_S)
    edges = np.searchsorted(hz, BANDS_HZ)
    edges[-1] = n
    sums = np.add.reduceat(power, edges[:-1], axis=1) if len(y) else np.zeros((0, len(edges) - 1))
    return np.asarray(np.sqrt(sums / np.maximum(mask.sum(axis=1), 1)[:, None]))
