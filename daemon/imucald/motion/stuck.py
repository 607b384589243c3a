"""Signals that are stuck: a sensor or a sender that repeats one value.

The value is wrong by as much as the truth has changed, and at the end it jumps. Three kinds
of signal, three tests: a sensor's noise always moves (`StuckSensor`, over blocks of ticks;
`HeldForce`, tick by tick), a speed that is rounded does not (`StuckSpeed`).
`model_compensation.held_repeats` finds nothing: it keeps a stuck sensor recognisable.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from imucald.core.rotations import Vector
from imucald.motion import ticks as tk
from imucald.motion.standstill import DRIVING_SPEED, ROLLING_SPEED
from imucald.motion.ticks import ACCEL, TICK_S, TickRow
from imucald.motion.usual_runs import MIN_STUCK_S, TIMES_USUAL, UsualRuns, runs_of

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

STUCK_TICKS = 12
"""Identical means of a sensor for that long are a stuck signal: noise always moves."""
STUCK_MOVING_TICKS = 5
"""So many of them while the vehicle rolls."""
HELD_TICKS = 10
"""Ticks of one force that never moved within a tick either: then a second is enough."""
STUCK_HOLE = 4
"""Ticks from one sample to the next, at most: 2.5 Hz."""
SAME = 1e-9
"""Means over nine and ten equal samples differ by rounding [m/s^2, rad/s]."""
STEADIEST = 0.01
"""No vehicle on a road keeps its speed better than that [m/s^2]."""
FINE = 0.1
"""So many of the changes are finer than what counts as the signal's step: rounding splits steps."""
SAME_SPEED = 1e-6
"""[m/s]"""
TURNING_WHEELS = 15
"""Ticks in which wheels turn and the speed is zero that make it stuck: a speed that begins at
4 km/h (inductive wheel sensors) is zero for a second of a launch at 1 m/s^2."""
WHEELS_WITHIN = np.ones(41)
"""They are counted within 2 s to both sides: of coarse wheel speeds not every tick's change."""


class StuckSensor:
    """Flags ticks of a sensor that repeats one value for STUCK_TICKS or longer, also in motion.

    At rest a coarse sensor may well be still; one that got stuck before the vehicle stopped is
    stuck there. The tick after it is flagged as well: its mean may be half of stuck samples.

    count, first: columns of its samples' number and of its first axis. moving: whether the vehicle
    is taken to move where no speed was received.
    """

    def __init__(self, count: int, first: int, moving: bool) -> None:
        self._count, self._axes, self._moving = count, slice(first, first + 3), moving
        self._held: Array | None = None  # (3,) values at which it is stuck

    def restart(self) -> None:
        """Time jumped: its next value is new."""
        self._held = None

    def flags(self, rows: Array) -> Flags:
        """Ticks (N,) at which it is stuck; rows: (N, COLUMNS)."""
        flags = np.zeros(len(rows), dtype=bool)
        at = np.flatnonzero(rows[:, self._count] > 0)
        values = rows[at, self._axes]
        x, y, z = (np.abs(values[1:] - values[:-1]) < SAME).T
        same = x & y & z
        if np.count_nonzero(same):
            self._flag_runs(rows, at, values, same & (np.diff(at) <= STUCK_HOLE), flags)
        self._held = values[-1].copy() if len(at) and flags[at[-1]] else None
        return one_more(flags)

    def _flag_runs(
        self, rows: Array, at: NDArray[np.int64], values: Array, same: Flags, flags: Flags
    ) -> None:
        received = rows[:, tk.SPEED.n] > 0
        latest = np.maximum.accumulate(np.where(received, np.arange(len(rows)), 0))
        moving = np.abs(rows[latest, tk.SPEED.mean]) > ROLLING_SPEED
        moving = np.where(rows[latest, tk.SPEED.n] > 0, moving, self._moving and not received.any())
        edges = np.flatnonzero(np.diff(np.concatenate(([0], same.astype(np.int8), [0]))))
        for first, last in edges.reshape(-1, 2):
            part = slice(at[first], at[last] + 1)
            held = self._held
            known = held is not None and bool((np.abs(values[first] - held) < SAME).all())
            driven = int(moving[part].sum()) >= STUCK_MOVING_TICKS
            if known or (part.stop - part.start >= STUCK_TICKS and driven):
                flags[part] = True


class HeldForce:
    """Counts ticks in which the force was the same, and did not move within the tick either."""

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Time jumped."""
        self._force: Vector | None = None
        self._ticks = 0

    def step(self, tick: TickRow, force: Vector) -> bool:
        """Take a tick and its mean force; return whether it is stuck, if the vehicle moves."""
        same = force == self._force and tick[ACCEL.min_x] == tick[ACCEL.max_x]
        self._ticks = self._ticks + 1 if same else 0
        self._force = force
        return self._ticks >= HELD_TICKS


def one_more(flags: Flags) -> Flags:
    """Flags with the tick after each flagged one."""
    out = flags.copy()
    out[1:] |= flags[:-1]
    return out


class StuckSpeed:
    """Flags ticks at which the speed is stuck while the vehicle drives.

    How long a sound speed keeps one value depends on its resolution: to stay within one step s for
    T seconds a vehicle has to keep its acceleration under s / T. A sender that repeats each value
    some times has longer runs all the time; those do not count. Both are learnt.
    """

    def __init__(self) -> None:
        self._ended = UsualRuns()
        """While driving: how long they lasted [s], the change after [m/s]."""
        self._value, self._lasted = math.nan, 0.0

    def take_usual(self, former: StuckSpeed) -> None:
        """Take the runs that another one has seen end."""
        self._ended = former._ended

    def restart(self) -> None:
        """Time jumped: the run before is over."""
        self._value = math.nan

    def flags(self, rows: Array, leaving: int) -> Flags:
        """Ticks (N,) with a speed that is stuck; rows: (N, COLUMNS), `leaving` leave next."""
        out = np.zeros(len(rows), dtype=bool)
        at = np.flatnonzero(rows[:, tk.SPEED.n] > 0)
        if not len(at):
            return out
        speed = rows[at, tk.SPEED.mean]
        first, last, change = runs_of(speed, SAME_SPEED)
        begins, ends = at[first], at[last]
        lasted = (ends - begins) * TICK_S
        if abs(speed[0] - self._value) <= SAME_SPEED:
            lasted[0] += self._lasted
        driving = np.abs(speed[first]) > DRIVING_SPEED
        stuck = driving & (lasted > MIN_STUCK_S)
        if np.count_nonzero(stuck):
            stuck &= lasted > self._limit()
            for begin, end in zip(begins[stuck].tolist(), ends[stuck].tolist(), strict=True):
                out[begin : end + 1] = True
        over = driving & ~stuck & (ends < leaving)
        over[-1] = False
        after = last[over]
        self._ended.add(lasted[over] + (at[after + 1] - at[after]) * TICK_S, change[after])
        self._value = math.nan
        crossing = np.flatnonzero((begins < leaving) & (leaving <= ends))
        if len(crossing):
            i = int(crossing[0])
            kept = at[int(np.searchsorted(at, leaving))]
            self._value = float(speed[first[i]])
            self._lasted = float(lasted[i]) - float(ends[i] - kept) * TICK_S
        return one_more(out)

    def take_short_runs(self, first: float, lasted: Array, change: Array) -> bool:
        """Take ticks all of which have a speed that keeps no value for long, see `short_runs`.

        first: their first speed [m/s]. lasted: (M,) of the runs while driving [s]; change: (M,)
        [m/s]. False: the first of them goes on from before, and `flags` has to look.
        """
        if abs(first - self._value) <= SAME_SPEED:
            return False
        self._ended.add(lasted, change)
        self._value = math.nan
        return True

    def _limit(self) -> float:
        """A run longer than that is stuck [s]; never, until the signal is known."""
        if not self._ended.known:
            return math.inf
        step = self._ended.change(FINE)
        return max(MIN_STUCK_S, step / STEADIEST, TIMES_USUAL * self._ended.usual)


def zero_while_wheels_turn(rows: Array) -> Flags:
    """Ticks (N,) with a speed of zero around which the wheels turn; rows: (N, COLUMNS).

    Wheels that stand give one speed each, whatever their offsets; so a spread of their speeds that
    changes from tick to tick is that of wheels that turn.
    """
    out = np.zeros(len(rows), dtype=bool)
    zero = (rows[:, tk.SPEED.n] > 0) & (np.abs(rows[:, tk.SPEED.mean]) <= SAME_SPEED)
    at = np.flatnonzero(rows[:, tk.WHEEL_SPREAD.n] > 0)
    if len(at) < TURNING_WHEELS or not np.count_nonzero(zero):
        return out
    spread = rows[at, tk.WHEEL_SPREAD.mean]
    turning = np.zeros(len(rows))
    turning[at[1:]] = np.abs(np.diff(spread)) > SAME_SPEED
    near = np.convolve(turning * zero, WHEELS_WITHIN, mode="same")
    return np.asarray(zero & (near > TURNING_WHEELS - 0.5))
