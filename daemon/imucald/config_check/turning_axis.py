"""Whether bends show in the gyroscope's axes that gravity says they must."""

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
    """Whether the force in bends follows the rate about the vertical, or that of another axis.

    Needs neither forward nor left. The level force is regressed on dv/dt and v r, r being the rate
    about the vertical as configured, or with a sign turned or axes exchanged: the likelihood ratio
    of what is left over (as in `alternatives`), where the other one explains much.
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
    # a zero error of the rate adds the speed in its own shape
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
            "the force in bends follows its rate about an axis that is not vertical: two "
            "axes of the gyroscope or of the accelerometer are exchanged"
        )
        yield Finding("error", "gyroscope", text)


def _energy_left(signals: Array, known: Array) -> float:
    """Energy that is left of signals (N, k) when columns (N, m) and a constant are taken off."""
    return float(np.square(less(signals, known)).sum())
