"""Test whether an equation's residual is larger than in the drives of the model file.

A model file may hold, by equation and band, the median residual of its drives' segments, with all
parameters fitted in their box, and the scatter between segments. Roads differ too: from one class
of ISO 8608 to the next the rms doubles. If the median residual of a later drive is larger than all
this allows, the drive contains an effect that the file does not know. No particular shape of the
residual is assumed.
"""

from __future__ import annotations

import numpy as np
from scipy.fft import dct

from imucald.core.arrays import Array
from imucald.diagnosis.equations.forward import UNITS
from imucald.diagnosis.fit.beside_file import ROAD_CLASS, Family, FamilyRow, Left, joined
from imucald.diagnosis.fit.blocks import LEAST_SHARE, MOVING_SHARE
from imucald.diagnosis.fit.score import Problem
from imucald.diagnosis.result import LOUDER
from imucald.diagnosis.search.state import State
from imucald.diagnosis.signals import STANDING_MPS, STEP_S, Mask
from imucald.model.leaves import BANDS_HZ

SHAKEN_FROM_HZ = {"accel_y": 0.4, "lateral_accel": 0.4, "accel_z": 0.0, "gyro_x": 0.0,
                  "gyro_y": 0.0}  # fmt: skip
"""Equations that contain the road's unevenness, with the lowest frequency of this effect. From this
frequency on, the chance is computed beyond a road of the next class. Well below its resonances (1
Hz and more; Rajamani, ch. 10) the body follows the road. Its tilt is then the only lateral effect
of the road, and the gyroscope carries it."""


def left_of(problem: Problem, state: State) -> dict[float, Left]:
    """By segment length [s] and equation: (B,) mean speed of each segment in motion, and (B, bands)
    rms residual in the equation's unit, after a fit of all parameters in their box."""
    changes = problem.fitted_changes()
    parts: dict[str, list[tuple[Array, Array]]] = {}
    for f in state.forwards:
        masks = f.usable()
        v = f.amount_of_speed().reshape(f.blocks, f.rows)
        moving = (v > STANDING_MPS).mean(axis=1) >= MOVING_SHARE
        for name, y in f.level(f.residuals(changes), masks).items():
            good = moving & (masks[name].mean(axis=1) >= LEAST_SHARE)
            rms = _by_band(y[good], masks[name][good])
            parts.setdefault(name, []).append((v[good].mean(axis=1), rms))
    return {problem.table.seconds: joined(parts)}


def _by_band(y: Array, mask: Mask) -> Array:
    """Rms (B, bands) of the present rows (B, n)."""
    n = y.shape[1]
    power = dct(np.where(mask, y, 0.0), type=2, axis=1, norm="ortho") ** 2
    hz = np.arange(n) / (2.0 * n * STEP_S)
    edges = np.searchsorted(hz, BANDS_HZ)
    edges[-1] = n
    sums = np.add.reduceat(power, edges[:-1], axis=1) if len(y) else np.zeros((0, len(edges) - 1))
    return np.asarray(np.sqrt(sums / np.maximum(mask.sum(axis=1), 1)[:, None]))


def _row(name: str, band: int) -> FamilyRow:
    """Return the row of one number. If roads shake the vehicle at this frequency, the chance is
    computed beyond one road class."""
    low, high = BANDS_HZ[band : band + 2]
    road = float(np.log(ROAD_CLASS))
    is_shaken = low >= SHAKEN_FROM_HZ.get(name, np.inf)
    return FamilyRow(
        road,
        lambda middle, more: (
            f"between {low:g} and {high:g} Hz the residual of half of the segments is at least "
            f"{middle:.2g} {UNITS[name]}. That is {np.exp(more):.2g} times the residual that the "
            f"model file states. A road of the next class gives {ROAD_CLASS:g} times as much. "
            "Something acts there that the model file does not contain"
        ),
        start=road * is_shaken,
    )


LEAVES = Family(LOUDER, _row)
"""Residuals of segments by equation and band."""
