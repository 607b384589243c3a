"""Least squares within bounds."""

from __future__ import annotations

import numpy as np

from imucald.core.arrays import Array
from imucald.diagnosis.signals import Mask

RIDGE = 1e-9


def box_fit(H: Array, c: Array, low: Array, high: Array, start: Array | None = None) -> Array:
    """Return the x (Q,) that minimises x'Hx/2 - c'x within low <= x <= high.

    The primal active-set method (Nocedal and Wright, ch. 16) is used: it takes a Newton step up to
    the first bound, and releases one bound at a time, the bound with the largest multiplier.
    """
    scale = 0.5 * (high - low)
    H = H * np.outer(scale, scale)
    H = H + np.diag(RIDGE * np.diag(H) + RIDGE)
    c, low, high = c * scale, low / scale, high / scale
    x = np.clip(np.zeros(len(c)) if start is None else start / scale, low, high)
    slope = H @ x - c
    held = ((x <= low) & (slope > 0.0)) | ((x >= high) & (slope < 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        for _ in range(20 * len(c)):
            step = _newton_step(H, H @ x - c, held)
            room = np.where(step > 0.0, high - x, low - x) / step
            room[step == 0.0] = np.inf
            first = int(room.argmin())
            if room[first] < 1.0:
                x = np.minimum(np.maximum(x + max(room[first], 0.0) * step, low), high)
                x[first] = high[first] if step[first] > 0.0 else low[first]
                held[first] = True
                continue
            x = np.minimum(np.maximum(x + step, low), high)
            slope = H @ x - c
            pull = np.where(x >= high, slope, -slope) * held
            worst = int(pull.argmax())
            if pull[worst] <= 1e-9 * (1.0 + abs(c[worst])):
                break
            held[worst] = False
    return np.asarray(x * scale)


def _newton_step(H: Array, slope: Array, held: Mask) -> Array:
    step = np.zeros(len(slope))
    free = (~held).nonzero()[0]
    if len(free):
        part = H[free[:, None], free]
        try:
            step[free] = -np.linalg.solve(part, slope[free])
        except np.linalg.LinAlgError:
            step[free] = -np.linalg.lstsq(part, slope[free], rcond=None)[0]
    return step
