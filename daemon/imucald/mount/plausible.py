"""Which ticks must not be learnt from: saturated, implausible, wheels that slip.

Every reason is counted. A frozen tick is taken out of every window and sum; what is known stays.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from imucald.core.samples import GRAVITY
from imucald.motion import ticks as tk
from imucald.motion.ticks import TICK_S
from imucald.mount.estimator_settings import EstimatorSettings

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

FORCE_LOW, FORCE_HIGH = 0.5 * GRAVITY, 1.7 * GRAVITY
"""Mean specific force outside is no road vehicle on a road."""
MAX_RATE = 4.0
"""Nor does one turn faster [rad/s]."""
NEAR_FULL_SCALE = 0.98
SPREAD_FLOOR, SPREAD_SLOPE = 0.6, 0.03
"""Wheel speeds may differ by this [m/s] and this share of the speed, beyond the curve."""
CURVE_SHARE = 1.5
"""In a curve they may differ by this times track times yaw rate."""
MAX_CHANGE = 12.0
"""No road vehicle changes its speed faster [m/s^2]."""
HOLD_TICKS = 10
"""Ticks around a wheel-slip event or a jump of the speed that are not learnt from either."""
CLIP_TICKS = 3
"""The same around a saturated sample."""


def spread_out(flags: Flags, ticks: int) -> Flags:
    """Flags widened by that many ticks to both sides."""
    out = flags.copy()
    for i in np.flatnonzero(flags):
        out[max(0, i - ticks) : i + ticks + 1] = True
    return out


def forbidden(
    rows: Array,
    force: Array,
    ok_force: Flags,
    speed: Array,
    ok_speed: Flags,
    curve: Array,
    settings: EstimatorSettings,
    counts: Counter[str],
) -> Flags:
    """Ticks (N,) that nothing may be learnt from; `counts` gets the number for each reason.

    rows: (N, COLUMNS) ticks. force: (N, 3). speed: (N,). curve: (N,) size of the yaw rate [rad/s].
    """
    size2 = (force * force).sum(axis=1)
    bad: Flags = ok_force & ((size2 < FORCE_LOW**2) | (size2 > FORCE_HIGH**2))
    bad |= curve > MAX_RATE
    tally(counts, "implausible", bad)
    high = NEAR_FULL_SCALE * settings.accel_range
    top, low = slice(tk.ACCEL_MAX_X, tk.ACCEL_MAX_X + 3), slice(tk.ACCEL_MIN_X, tk.ACCEL_MIN_X + 3)
    clipped = (np.maximum(rows[:, top], -rows[:, low]) > high).any(axis=1)
    clipped |= rows[:, tk.ACCEL_BAD] > 0
    if tally(counts, "saturated", clipped):
        bad |= spread_out(clipped, CLIP_TICKS)
    slip = rows[:, tk.WHEELS_N] > 0
    if slip.any():
        allowed = SPREAD_FLOOR + SPREAD_SLOPE * np.abs(speed)
        allowed += CURVE_SHARE * settings.track * curve
        slip &= np.nan_to_num(rows[:, tk.WHEEL_SPREAD]) > allowed
        if tally(counts, "wheel_slip", slip):
            bad |= spread_out(slip, HOLD_TICKS)
    wild = ok_speed & (np.abs(np.gradient(speed, TICK_S)) > MAX_CHANGE)
    if tally(counts, "speed_jump", wild):
        bad |= spread_out(wild, HOLD_TICKS)
    return bad


def tally(counts: Counter[str], reason: str, flags: Flags) -> bool:
    """Add the flagged ticks to a reason's number; True if there are any."""
    if not flags.any():
        return False
    counts[reason] += int(flags.sum())
    return True
