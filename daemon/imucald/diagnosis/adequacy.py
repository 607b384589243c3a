"""What is left when the search has ended, tested without a cause in mind."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imucald.diagnosis.forward import Forward
from imucald.diagnosis.result import GOES_AGAINST, Structure
from imucald.diagnosis.score import Problem
from imucald.diagnosis.search import State

OPPOSITE = -0.4
"""Correlation of a signal with its prediction below which a sign is wrong."""
LEAST_ROWS = 300


def goes_against(forwards: Sequence[Forward]) -> list[Structure]:
    """Signals that move against what is predicted: a wrong sign in the configuration."""
    found = []
    f = max(forwards, key=lambda f: f.blocks)
    measured, residual, masks = f.measured(), f.residuals({}).of, f.usable()
    for name in ("accel_x", "accel_y", "gyro_z", "yaw_rate", "lateral_accel"):
        if name not in residual or name not in masks:
            continue
        good = masks[name].ravel()
        if good.sum() < LEAST_ROWS:
            continue
        y = measured[name][good]
        p = y - residual[name].ravel()[good]
        if np.std(y) == 0.0 or np.std(p) == 0.0:
            continue
        r = float(np.corrcoef(y, p)[0, 1])
        if r < OPPOSITE:
            text = f"measured and predicted go against each other (correlation {r:.2f})"
            found.append(Structure(name, GOES_AGAINST, abs(r), text))
    return found


def what_is_left(problem: Problem, state: State) -> list[Structure]:
    """Structure beyond chance."""
    del problem, state
    return []
