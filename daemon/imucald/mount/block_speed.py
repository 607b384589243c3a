"""Speed in blocks of ticks on an even time grid: its sign, and the ticks at which the vehicle is at
rest."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from imucald.core.arrays import Array, Flags
from imucald.motion import ticks as tk
from imucald.motion.coarse_speed import COARSE, comes_in, stays, step_of
from imucald.motion.signal_health import SignalHealth
from imucald.motion.standstill import (
    DRIVING_SPEED,
    ROLLING_SPEED,
    STEADY_TICKS,
    ZERO_SPEED,
    is_parked,
)
from imucald.motion.stuck import SeenForward
from imucald.mount.even_signals import BLOCK_TICKS, PART, bridged_speed

REST_TICKS = 12
"""Number of ticks with zero speed after which the vehicle is at rest: the jerk of braking is then
over.
"""


class BlockSpeed:
    """Follows the speed from block to block. N = BLOCK_TICKS.

    seen: set to which "speed" and "reverse" are added once such a signal was received. least: speed
    up to which the vehicle may creep while its speed signal is zero [m/s].
    """

    def __init__(self, health: SignalHealth, seen: set[str]) -> None:
        self._health, self._seen = health, seen
        self._reverse = 0.0
        self._rest_run = 0
        self.least = DRIVING_SPEED
        self.knots: Array | None = None
        """Times (K,) at which the speed of the last block is known [s]; None: in each tick."""
        self._step = 0.0
        """Resolution step of the speed signal [m/s]; 0 until a step was seen. The step of a noisy
        signal cannot be seen."""
        self._is_rolling = False  # when the speed was last known, or while it is stuck

    @property
    def direction(self) -> float:
        """-1 while the reverse gear is engaged, otherwise 1."""
        return -1.0 if self._reverse else 1.0

    def restart(self) -> None:
        """Restart after a jump of time."""
        self._rest_run = 0
        self._is_rolling = False

    def speed_in_block(
        self, rows: Array, t: Array, at: Array, seen: Callable[[], SeenForward | None]
    ) -> tuple[Array, Flags]:
        """Return the speed (N + 2,) of a block, and a flag for each value that is known.

        rows: (ROWS, COLUMNS) ticks. t: end times of `rows` [s]. at: (N + 2,) times of the returned
        speed [s]. seen: gives the speed changes that the accelerometer shows, for all ticks.
        """
        stuck = self._health.stuck_speed(rows, seen)
        has = rows[:, tk.SPEED.n] > 0
        if np.count_nonzero(has):
            self._seen.add("speed")
        has &= ~stuck
        mean, is_whole = rows[has, tk.SPEED.mean], bool(has.all())
        self._follow_least_speed(np.abs(mean))
        step = self._step_of(mean, rows[has, tk.SPEED.n])
        times = t[has] - rows[has, tk.SPEED.age]
        speed, ok, self.knots = bridged_speed(at, times, mean, step, is_whole)
        self._step = step or self._step
        if np.count_nonzero(ok):
            self._is_rolling = abs(float(speed[ok][-1])) > ROLLING_SPEED
        elif np.count_nonzero(stuck):
            self._is_rolling = True
        known = rows[:, tk.REVERSE]
        if not np.isnan(known).all():
            self._seen.add("reverse")
        if self._reverse or np.count_nonzero(known > 0.5):
            reverse = self._held(known)[PART]
            return np.where(reverse > 0.5, -speed, speed), ok
        return speed, ok

    def _step_of(self, mean: Array, counts: Array) -> float:
        """Return the resolution step of the speeds (M,) of a block; 0: not coarse.

        The step that earlier blocks showed may not show in this block.
        """
        own = step_of(mean) if len(mean) and stays(mean[None])[0] else 0.0
        own = own if own >= COARSE else 0.0
        return self._step if own < self._step and comes_in(self._step, mean, counts) else own

    def silence_parked(self, speed: Array, ok: Flags, force: Array, rate: Array | None) -> None:
        """Set the speed to zero if it is noise and the sensor is as still as in a parked vehicle.

        Wheel sensors may send no pulses below `DRIVING_SPEED`, so a vehicle that creeps slower than
        this counts as resting.
        """
        sizes = np.abs(speed)
        if self._reverse or not ok.all() or sizes.min() > ROLLING_SPEED:
            return
        end = len(speed) - 1
        for first in range(1, end, STEADY_TICKS):
            part = slice(first, first + STEADY_TICKS)
            if not ZERO_SPEED < float(sizes[part].mean()) < ROLLING_SPEED:
                continue
            if is_parked(force[part], None if rate is None else rate[part]).all():
                speed[first - (first == 1) : part.stop + (part.stop == end)] = 0.0

    def _follow_least_speed(self, sizes: Array) -> None:
        """Update the smallest speed that was seen.

        A speed counts only if the ticks before and after it are moving too. In a tick in which the
        vehicle stops or starts, the mean speed of the tick is too small.
        """
        moves = sizes > ZERO_SPEED
        between = moves[1:-1] & moves[:-2] & moves[2:]
        if np.count_nonzero(between):
            self.least = min(self.least, float(sizes[1:-1][between].min()))

    def _held(self, known: Array) -> Array:
        """Return the reverse signal of each row, with the last known value held.

        The value at the end of the block's own ticks is stored for the next block.
        """
        out = np.empty(len(known))
        value = self._reverse
        for i, k in enumerate(known.tolist()):
            if not math.isnan(k):
                value = k
            out[i] = value
            if i == BLOCK_TICKS - 1:
                self._reverse = value
        return out

    def rest(self, speed: Array, ok: Flags, force: Array, rate: Array, ok_rate: Flags) -> Flags:
        """Return flags for the ticks at rest: the speed is zero, or the force is still where the
        speed is unknown.

        A speed that is lost while driving does not count as rest, because the force is as still
        during smooth cruising.
        """
        rest = np.zeros(len(speed), dtype=bool)
        if np.count_nonzero(ok):
            still = ok & (np.abs(speed) < ZERO_SPEED)
        elif self._is_rolling:
            self._rest_run = 0
            return rest
        else:
            still = is_parked(force, rate if ok_rate.any() else None)
        run = self._rest_run
        if not np.count_nonzero(still):
            self._rest_run = 0
            return rest
        for i, s in enumerate(still.tolist()):
            run = run + 1 if s else 0
            rest[i] = run > REST_TICKS
        self._rest_run = run
        return rest
