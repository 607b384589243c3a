"""More is left of an equation than the drives left that the model file was made of.

A model file may carry, by equation and band, what half of their segments left, with everything
fitted in its box, and how far segments differ. Roads differ as well: from one class of ISO 8608 to
the next the rms is twice as large. A later drive whose middle segment leaves more than that, beyond
what segments scatter by, has something that the file does not know. No shape is asked for.
"""

from __future__ import annotations

from itertools import pairwise

import msgspec
import numpy as np
from scipy.fft import dct
from scipy.stats import t as student

from imucald.diagnosis.equations.forward import UNITS
from imucald.diagnosis.fit.blocks import LEAST_SHARE, MOVING_SHARE
from imucald.diagnosis.fit.chance import Question
from imucald.diagnosis.fit.score import Problem
from imucald.diagnosis.result import LOUDER, Structure
from imucald.diagnosis.search.state import State
from imucald.diagnosis.signals import STANDING_MPS, STEP_S, Array, Mask
from imucald.model.leaves import BANDS_HZ, Bands, Leaves
from imucald.model.model import VehicleModel

LEAST_SEGMENTS = 10
ROAD_CLASS = 2.0
"""rms of a road over that of the next class (ISO 8608: spectral densities are 4 apart)."""
SHAKEN = ("accel_y", "accel_z", "gyro_x", "gyro_y", "lateral_accel")
"""Equations in which the road's unevenness stands: chance starts from a road of the next class."""
ONE_IN = 4.0
"""Slow roads last over neighbours: so many segments count as one."""
MEDIAN = float(np.sqrt(0.5 * np.pi))
"""Deviation of the median over that of the mean, of normal numbers."""
LEAST_RMS = 1e-9
INSIDE = (0.05, 0.95)
Left = dict[str, tuple[Array, Array]]


def left_of(problem: Problem, state: State) -> Left:
    """By equation: (B,) mean speed of each segment in motion, (B, bands) rms that is left of it in
    the equation's unit, everything fitted in its box."""
    x = problem.fit()
    changes = {k: float(v) for k, v in zip(problem.table.keys, x, strict=True) if v}
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


def leaves_of(left: Left, segment_s: float) -> dict[str, Leaves]:
    """What a model file carries of that."""
    made = {}
    for name, (v, rms) in left.items():
        if len(v) >= LEAST_SEGMENTS:
            low, high = np.quantile(v, INSIDE)
            logs = np.log(np.maximum(rms, LEAST_RMS))
            middle, spread = np.exp(np.median(logs, axis=0)), logs.std(axis=0, ddof=1)
            speeds = (round(float(low), 2), round(float(high), 2))
            made[name] = Leaves(len(v), segment_s, speeds, six(middle), six(spread))
    return made


def six(x: Array) -> Bands:
    """The numbers (6,) of a section of the file."""
    a, b, c, d, e, f = (short(each) for each in x)
    return a, b, c, d, e, f


def short(x: float) -> float:
    """Four digits of a number."""
    return float(f"{x:.4g}")


def with_leaves(model: VehicleModel, problem: Problem, state: State) -> VehicleModel:
    """The model file with what these drives leave; of other equations with what it had."""
    leaves = leaves_of(left_of(problem, state), problem.table.seconds)
    return model.with_changes({"leaves": msgspec.to_builtins({**model.leaves, **leaves})})


def louder(problem: Problem, state: State) -> list[Question]:
    """Whether more is left of an equation in a band than the model file states.

    Only segments at speeds of the file's are asked, of the same length.
    """
    stated = state.stated.leaves
    if not stated:
        return []
    asked = []
    for name, (v, rms) in left_of(problem, state).items():
        file = stated.get(name)
        if file is None or file.segment_s != problem.table.seconds:
            continue
        inside = (v >= file.speeds_mps[0]) & (v <= file.speeds_mps[1])
        if min(inside.sum(), file.segments) >= LEAST_SEGMENTS:
            asked += _of_equation(name, rms[inside], file)
    return asked


def beside_file(rms: Array, file: Leaves) -> tuple[Array, Array, Array, float]:
    """Logarithms (B, 6) of what segments leave, by how much their medians (6,) exceed the file's,
    its deviations, and degrees of freedom."""
    logs = np.log(np.maximum(rms, LEAST_RMS))
    own, known = len(logs) / ONE_IN, file.segments / ONE_IN
    more = np.median(logs, axis=0) - np.log(np.maximum(file.rms, LEAST_RMS))
    variance = logs.var(axis=0, ddof=1) / own + np.square(file.spread) / known
    return logs, more, MEDIAN * np.sqrt(np.maximum(variance, 1e-12)), own + known - 2.0


def _of_equation(name: str, rms: Array, file: Leaves) -> list[Question]:
    """One question a band. rms: (B, bands)."""
    logs, more, se, free = beside_file(rms, file)
    road = np.log(ROAD_CLASS)
    null = road if name in SHAKEN else 0.0
    chance = student.sf((more - null) / se, free)
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
        made.append(Question(float(chance[i]), bool(more[i] - se[i] > road), structure))
    return made
