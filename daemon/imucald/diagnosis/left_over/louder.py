"""More is left of an equation than the drives left that the model file was made of.

A model file may carry, by equation and band, what half of their segments left, with everything
fitted in its box, and how far segments differ. Roads differ as well: from one class of ISO 8608 to
the next the rms is twice as large. A later drive whose middle segment leaves more than that, beyond
what segments scatter by, has something that the file does not know. No shape is asked for.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.fft import dct
from scipy.stats import t as student

from imucald.core.arrays import Array
from imucald.diagnosis.equations.forward import UNITS
from imucald.diagnosis.fit.beside_file import (
    ROAD_CLASS,
    Left,
    beside_file,
    in_both,
    leaves_of,
    with_entries,
)
from imucald.diagnosis.fit.blocks import LEAST_SHARE, MOVING_SHARE
from imucald.diagnosis.fit.chance import Question, chance_of_large
from imucald.diagnosis.fit.score import Problem
from imucald.diagnosis.result import LOUDER, Structure
from imucald.diagnosis.search.state import State
from imucald.diagnosis.signals import STANDING_MPS, STEP_S, Mask
from imucald.model.leaves import BANDS_HZ, Leaves
from imucald.model.model import VehicleModel

SHAKEN_FROM_HZ = {"accel_y": 0.4, "lateral_accel": 0.4, "accel_z": 0.0, "gyro_x": 0.0,
                  "gyro_y": 0.0}  # fmt: skip
"""Equations in which the road's unevenness stands, and from where on: chance starts from a road of
the next class. Well below its resonances (1 Hz and more; Rajamani, ch. 10) the body stands on the
road as it lies, and its tilt, which is all that the road does sideways, the gyroscope carries."""


def left_of(problem: Problem, state: State) -> Left:
    """By equation: (B,) mean speed of each segment in motion, (B, bands) rms that is left of it in
    the equation's unit, everything fitted in its box."""
    changes = problem.fitted_changes()
    parts: dict[str, list[tuple[Array, Array]]] = {}
    for f in state.forwards:
        masks = f.usable()
        v = np.interp(f.t, f.knots, np.abs(f.drive.knots.values)).reshape(f.blocks, f.rows)
        moving = (v > STANDING_MPS).mean(axis=1) >= MOVING_SHARE
        for name, y in f.level(f.residuals(changes), masks).items():
            good = moving & (masks[name].mean(axis=1) >= LEAST_SHARE)
            rms = _by_band(y[good], masks[name][good])
            parts.setdefault(name, []).append((v[good].mean(axis=1), rms))
    return {
        name: (np.concatenate([v for v, _ in p]), np.concatenate([rms for _, rms in p]))
        for name, p in parts.items()
    }


def _by_band(y: Array, mask: Mask) -> Array:
    """rms (B, bands) of rows (B, n) that are there."""
    n = y.shape[1]
    power = dct(np.where(mask, y, 0.0), type=2, axis=1, norm="ortho") ** 2
    hz = np.arange(n) / (2.0 * n * STEP_S)
    edges = np.searchsorted(hz, BANDS_HZ)
    edges[-1] = n
    sums = np.add.reduceat(power, edges[:-1], axis=1) if len(y) else np.zeros((0, len(edges) - 1))
    return np.asarray(np.sqrt(sums / np.maximum(mask.sum(axis=1), 1)[:, None]))


def with_leaves(model: VehicleModel, problem: Problem, state: State) -> VehicleModel:
    """The model file with what these drives leave; of other equations with what it had."""
    return with_entries(model, leaves_of(left_of(problem, state), problem.table.seconds))


def louder(problem: Problem, state: State) -> list[Question]:
    """Whether more is left of an equation in a band than the model file states.

    Only segments at speeds of the file's are asked, of the same length.
    """
    stated = state.stated.leaves
    if not stated:
        return []
    asked = in_both(left_of(problem, state), stated, problem.table.seconds)
    return [q for name, rms, file in asked for q in _of_equation(name, rms, file)]


def _of_equation(name: str, rms: Array, file: Leaves) -> list[Question]:
    """One question a band. rms: (B, bands)."""
    logs, more, se, free = beside_file(rms, file)
    road = np.log(ROAD_CLASS)
    is_shaken = np.array(BANDS_HZ[:-1]) >= SHAKEN_FROM_HZ.get(name, np.inf)
    chance = student.sf((more - road * is_shaken) / se, free)
    made = []
    for i, (low, high) in enumerate(pairwise(BANDS_HZ)):
        ratio = float(np.exp(more[i]))
        text = (
            f"between {low:g} and {high:g} Hz half of the segments leave "
            f"{np.exp(np.median(logs[:, i])):.2g} {UNITS[name]} and more, {ratio:.2g} times what "
            "the model file states of its own drives, where a road of the next class leaves "
            f"{ROAD_CLASS:g} times as much: something acts there that the file does not know"
        )
        structure = Structure(name, LOUDER, ratio / ROAD_CLASS, text)
        # Where roads shake, chance starts from a class that does look large.
        rare = 1.0 if is_shaken[i] else chance_of_large(float(road), float(se[i]), float(free[i]))
        made.append(Question(float(chance[i]), bool(more[i] - se[i] > road), structure, rare))
    return made
