"""Check whether the gyroscope shows bends in the axis that is vertical according to gravity."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from imucald.config_check.finding import MIN_TICKS, Finding
from imucald.config_check.motion import Motion, less, smooth
from imucald.core.arrays import Array
from imucald.mount.contradictions import LIKE, MOVING
from imucald.mount.gyro_alternatives import TRIED
from imucald.mount.log_ratios import INDEPENDENT, TO_ACCUSE
from imucald.mount.signal_blocks import BLOCK_TICKS


def turning_axis_findings(motion: Motion) -> Iterator[Finding]:
    """Check whether the specific force in bends is proportional to the rate about the vertical or
    to another rate.

    For this check, the directions forward and left need not be known. The horizontal force is
    fitted with dv/dt and with the product v r of speed and rate. The rate r is the rate about the
    vertical, with the gyroscope axes as configured, with a reversed sign, or with exchanged axes.
    An alternative is reported if the likelihood ratio of the residuals prefers it (as in
    `mount.alternatives`) and it explains most of the force.
    """
    up, gravity = motion.up, motion.gravity
    if up is None or gravity is None or motion.accel is None or "gyro" not in motion.grid:
        return
    if motion.speed is None or motion.change is None:
        return
    rate = smooth(motion.grid["gyro"])
    n = min(len(rate), len(motion.speed), len(motion.accel))
    level = (motion.accel[:n] - gravity) @ (np.eye(3) - np.outer(up, up))
    speed, change = motion.speed[:n], motion.change[:n]
    table = np.column_stack([level, change, speed, rate[:n]])
    table = table[np.isfinite(table).all(axis=1)]
    table = table[np.abs(table[:, 4]) > MOVING]
    if len(table) < MIN_TICKS:
        return
    level, change, speed, rate = table[:, :3], table[:, 3], table[:, 4], table[:, 5:]
    # a zero error of the rate adds a term proportional to the speed
    without = _energy_left(level, np.column_stack([change, speed]))
    left = [
        _energy_left(level, np.column_stack([change, speed, speed * (rate @ (S.T @ up))]))
        for S in TRIED
    ]
    best = min(left)
    if best <= 0.0 or 1.0 - best / max(without, 1e-12) < LIKE**2:
        return
    independent = INDEPENDENT * len(table) / BLOCK_TICKS
    if 0.5 * independent * 2.0 * math.log(left[0] / best) > TO_ACCUSE:
        text = (
            "in bends, the force follows the gyroscope's rate about an axis that is not "
            "vertical: two axes of the gyroscope or of the accelerometer are exchanged"
        )
        yield Finding("error", "gyroscope", text)


def _energy_left(signals: Array, known: Array) -> float:
    """Residual energy of signals (N, k) after a fit with columns (N, m) and a constant."""
    return float(np.square(less(signals, known)).sum())
