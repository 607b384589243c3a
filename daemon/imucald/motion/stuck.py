"""Signals that are stuck: a sensor or a sender that repeats one value.

The value is wrong by as much as the truth has changed, and at the end it jumps. Three kinds
of signal, three tests: a sensor's noise always moves (`StuckSensor`, over blocks of ticks;
`HeldForce`, tick by tick), a speed that is rounded does not, and is held against the forward force
(`StuckSpeed`).
`model_compensation.held_repeats` finds nothing: it keeps a stuck sensor recognisable.

Runs of equal values of one signal: where they are, and how long they usually last.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.core.arrays import Array, true_runs
from imucald.core.rotations import Vector
from imucald.motion import ticks as tk
from imucald.motion.coarse_speed import SAME_SPEED
from imucald.motion.standstill import DRIVING_SPEED, ROLLING_SPEED
from imucald.motion.ticks import ACCEL, TICK_S, TickRow

Places = NDArray[np.int64]

MIN_STUCK_S = 1.2
"""Nothing shorter is called stuck."""
TIMES_USUAL = 4.0
"""And so many times the usual run."""
RUNS_REMEMBERED = 200
MIN_RUNS = 50
"""Before so many nothing is called stuck."""


class EqualRuns(NamedTuple):
    """Runs of equal values: places (M,) of the first and last of each; `change`: (N - 1,), the
    size of the change after each value."""

    first: Places
    last: Places
    change: Array


def runs_of(values: Array, same: float) -> EqualRuns:
    """The runs in values (N,), N > 0, that differ by no more than `same` from one to the next."""
    change = np.abs(values[1:] - values[:-1])
    ended = np.flatnonzero(change > same)
    first, last = np.zeros((2, len(ended) + 1), np.int64)
    first[1:], last[:-1], last[-1] = ended + 1, ended, len(values) - 1
    return EqualRuns(first, last, change)


SHORT_TICKS = 11
"""No run of so many ticks lasts longer than MIN_STUCK_S."""


def short_runs(
    values: Array, same: float, leaving: int
) -> tuple[NDArray[np.bool_], Places, Places, Places, Array]:
    """Runs in each row of values (B, N) that end among its first `leaving`.

    Returns whether all of a row's runs are short and none goes on from the first `leaving` to the
    others (B,); and of each run (M,) its row, the places of its first and last value, and the size
    of the change after it.
    """
    change = np.abs(values[:, 1:] - values[:, :-1])
    is_over = change > same
    ended = np.zeros(values.shape, np.int64)
    np.cumsum(is_over, axis=1, out=ended[:, 1:])
    simple = (ended[:, SHORT_TICKS:] > ended[:, :-SHORT_TICKS]).all(axis=1)
    simple &= is_over[:, leaving - 1]
    row, last = np.nonzero(is_over[:, :leaving])
    first = np.zeros_like(last)
    goes_on = np.flatnonzero(row[1:] == row[:-1])
    first[goes_on + 1] = last[goes_on] + 1
    return simple, row, first, last, change[row, last]


class UsualRuns:
    """The last RUNS_REMEMBERED runs that ended: how long each lasted, and the change after it."""

    def __init__(self) -> None:
        self._runs = np.zeros((RUNS_REMEMBERED, 2))
        self._ended = 0

    def add(self, lasted: Array, change: Array) -> None:
        """Remember runs that ended: (M,) how long, (M,) the change after."""
        if not len(lasted):
            return
        place = (self._ended + np.arange(len(lasted))) % RUNS_REMEMBERED
        self._runs[place, 0], self._runs[place, 1] = lasted, change
        self._ended += len(lasted)

    @property
    def known(self) -> bool:
        """Whether enough have ended to say what is usual."""
        return self._ended >= MIN_RUNS

    @property
    def usual(self) -> float:
        """How long a run lasts, as seen at any time: long ones weigh more."""
        lasted = self._runs[: self._ended, 0]
        return float(lasted @ lasted / lasted.sum())

    def repeated(self, share: float, times: float) -> float:
        """How long a run of a sender lasts that repeats its values; 0: it does not.

        Most of its changes are then larger than so many times its step, the change that a share of
        all changes does not exceed.
        """
        lasted, change = self._runs[: self._ended].T
        is_jump = change > times * self.change(share)
        if 2 * np.count_nonzero(is_jump) <= len(change):
            return 0.0
        return float(lasted[is_jump] @ lasted[is_jump] / lasted[is_jump].sum())

    def change(self, share: float) -> float:
        """The change that this share of all changes does not exceed."""
        return quantile(self._runs[: self._ended, 1], share)


def quantile(values: Array, share: float) -> float:
    """As numpy.quantile, which loads its masked arrays for it (7 ms, 1.2 MiB)."""
    ordered = np.sort(values)
    place = share * (len(ordered) - 1)
    low = int(place)
    high = min(low + 1, len(ordered) - 1)
    return float(ordered[low] + (place - low) * (ordered[high] - ordered[low]))


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
SPLIT, JUMPS = 0.1, 1.5
"""So many of the changes are finer than the signal's step: means over ticks split steps. A sender
that repeats its values jumps by more than so many steps most of the time."""
LARGE = 0.9
"""A speed may be off by as much as so many of its changes come to."""
GAINED = 1.5
"""... and by so much more [m/s]: the answer of the body and of the vertical to hard braking."""
HARD, DEVIATIONS = 2.0, 3.0
"""While the delay of the speed is not known, braking [m/s^2] may come that much earlier."""
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
        for first, last in true_runs(same):
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


class SeenForward(Struct, frozen=True):
    """What the accelerometer says of the speed, of the ticks (N,) that are looked at.

    accel: forward force without gravity [m/s^2]. late: the speed, behind it [s], and how well that
    is known. drift: by so much the force may be off for long [m/s^2].
    """

    accel: Array
    late: float
    late_std: float
    drift: float


class StuckSpeed:
    """Flags ticks at which the speed is stuck: the force says that it has changed.

    A coarse speed keeps a value while its vehicle keeps its speed, for minutes; a sender that
    repeats each value some times has long runs all the time. So a run is held against the forward
    force within it, and a sender that repeats is given four of its usual runs. Where no mount is
    known nothing is called stuck: then nothing rests on the speed either.
    """

    def __init__(self) -> None:
        self._ended = UsualRuns()
        """While driving: how long they lasted [s], the change after [m/s]."""
        self.restart()

    def take_usual(self, former: StuckSpeed) -> None:
        """Take the runs that another one has seen end."""
        self._ended = former._ended

    def restart(self) -> None:
        """Time jumped: the run before is over."""
        self._value, self._lasted = math.nan, 0.0
        self._low = np.zeros(2)  # see `_gained`
        self._is_stuck = False

    def flags(self, rows: Array, leaving: int, seen: SeenForward | None) -> Flags:
        """Ticks (N,) with a speed that is stuck; rows: (N, COLUMNS), `leaving` leave next.

        seen: None where nobody knows what the speed should do.
        """
        out = np.zeros(len(rows), dtype=bool)
        at = np.flatnonzero(rows[:, tk.SPEED.n] > 0)
        if not len(at):
            return out
        speed = rows[at, tk.SPEED.mean]
        first, last, change = runs_of(speed, SAME_SPEED)
        begins, ends = at[first], at[last]
        lasted = (ends - begins) * TICK_S
        goes_on = abs(speed[0] - self._value) <= SAME_SPEED
        if goes_on:
            lasted[0] += self._lasted
        driving = np.abs(speed[first]) > DRIVING_SPEED
        stuck = driving & (lasted > MIN_STUCK_S)
        against = None if seen is None else _against(seen)
        if np.count_nonzero(stuck):
            longer = lasted > self._limit()
            for i in np.flatnonzero(stuck).tolist():
                of_before = goes_on and i == 0
                stuck[i] = (of_before and self._is_stuck) or (
                    bool(longer[i])
                    and against is not None
                    and seen is not None
                    and self._gained(against, int(begins[i]), int(ends[i]), of_before)
                    > self._least(seen)
                )
            for begin, end in zip(begins[stuck].tolist(), ends[stuck].tolist(), strict=True):
                out[begin : end + 1] = True
        over = driving & ~stuck & (ends < leaving)
        over[-1] = False
        after = last[over]
        self._ended.add(lasted[over] + (at[after + 1] - at[after]) * TICK_S, change[after])
        crossing = np.flatnonzero((begins < leaving) & (leaving <= ends))
        if not len(crossing):
            self.restart()
            return one_more(out)
        i = int(crossing[0])
        kept = at[int(np.searchsorted(at, leaving))]
        low = self._low if goes_on and i == 0 else np.full(2, math.inf)
        self._value, self._is_stuck = float(speed[first[i]]), bool(stuck[i])
        self._lasted = float(lasted[i]) - float(ends[i] - kept) * TICK_S
        self._low = np.zeros(2)
        if against is not None:
            before = against[:, leaving - 1]
            lowest = against[:, begins[i] : leaving].min(axis=1)
            self._low = np.minimum(np.minimum(lowest, low) - before, 0.0)
        return one_more(out)

    def take_short_runs(self, first: float, lasted: Array, change: Array) -> bool:
        """Take ticks all of which have a speed that keeps no value for long, see `short_runs`.

        first: their first speed [m/s]. lasted: (M,) of the runs while driving [s]; change: (M,)
        [m/s]. False: the first of them goes on from before, and `flags` has to look.
        """
        if abs(first - self._value) <= SAME_SPEED:
            return False
        self._ended.add(lasted, change)
        self.restart()
        return True

    def _limit(self) -> float:
        """A run may be stuck if it is longer than that [s]; never, until the signal is known."""
        if not self._ended.known:
            return math.inf
        return max(MIN_STUCK_S, TIMES_USUAL * self._ended.repeated(SPLIT, JUMPS))

    def _least(self, seen: SeenForward) -> float:
        """By so much the force says at least that a stuck speed has changed [m/s]."""
        return self._ended.change(LARGE) + GAINED + HARD * DEVIATIONS * seen.late_std

    def _gained(self, against: Array, begin: int, end: int, of_before: bool) -> float:
        """The largest change of speed within a run that the force speaks of [m/s]."""
        part = against[:, begin : end + 1]
        lowest = np.minimum.accumulate(part, axis=1)
        if of_before:
            lowest = np.minimum(lowest, self._low[:, None])
        return float((part - lowest).max())


def _against(seen: SeenForward) -> Array:
    """The speed gained, and that lost, up to each tick (2, N), less what the force may be off."""
    n = len(seen.accel)
    gained = np.concatenate([[0.0], np.cumsum(seen.accel) * TICK_S])
    gained = np.interp(np.arange(1, n + 1) - seen.late / TICK_S, np.arange(n + 1), gained)
    drift = seen.drift * TICK_S * np.arange(1, n + 1)
    return np.stack([gained - drift, -gained - drift])


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
