"""Signals that are stuck: a sensor or a sender that repeats one value.

The value is wrong by as much as the truth has changed, and at the end it jumps. Two kinds
of signal, two tests: a sensor's noise always moves (`StuckSensor`, over blocks of ticks;
`HeldForce`, tick by tick), a speed or a yaw rate that is rounded does not, and is held against
another signal (`StuckSignal`).
`model_compensation.held_repeats` finds nothing: it keeps a stuck sensor recognisable.

Runs of equal values of one signal: where they are, and how long they usually last.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
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

    def repeated(self, share: float, times: float) -> float:
        """How long a run of a sender lasts that repeats its values, long ones weigh more; 0: none.

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
BEFORE_RUN = 12
"""Ticks before a run whose speeds say what it begins from."""
STUCK_MOVING_TICKS = 5
"""So many of them while the vehicle rolls."""
HELD_TICKS = 10
"""Ticks of one force that never moved within a tick either: then a second is enough."""
STUCK_HOLE = 4
"""Ticks from one sample to the next, at most: 2.5 Hz."""
SAME = 1e-9
"""Means over nine and ten equal samples differ by rounding [m/s^2, rad/s]."""
TURNED, STEPS = 0.008, 3.0
"""A yaw rate is stuck where the other one moves by so much [rad/s]: that comes to 3 deg in the
6.4 s of a block, which would be taken for a sensor that was turned. And by so many of its own
steps: rounding holds a value back by one, a sender's dead band by two."""
SMOOTH = np.full(10, 0.1)
"""The other yaw rate is taken as means over a second: vibration is no turn."""
SPLIT, JUMPS = 0.1, 1.5
"""So many of the changes are finer than the signal's step: means over ticks split steps. A sender
that repeats its values jumps by more than so many steps most of the time."""
LARGE = 0.9
"""A signal may be off by as much as so many of its changes come to: means over ticks split steps.
"""
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
        speed = latest_speed(rows)
        moving = (
            speed > ROLLING_SPEED if np.isfinite(speed[-1]) else np.full(len(rows), self._moving)
        )
        for first, last in true_runs(same):
            part = slice(at[first], at[last] + 1)
            held = self._held
            known = held is not None and bool((np.abs(values[first] - held) < SAME).all())
            driven = int(moving[part].sum()) >= STUCK_MOVING_TICKS
            if known or (part.stop - part.start >= STUCK_TICKS and driven):
                flags[part] = True


def latest_speed(rows: Array) -> Array:
    """Size of the speed last received in ticks (N, COLUMNS) up to each; NaN before the first."""
    received = rows[:, tk.SPEED.n] > 0
    latest = np.maximum.accumulate(np.where(received, np.arange(len(rows)), 0))
    return np.asarray(np.where(received[latest], np.abs(rows[latest, tk.SPEED.mean]), math.nan))


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
    is known. drift: by so much the force may be off for long [m/s^2]. hidden: up to so much the
    vehicle may creep while its speed is zero [m/s].
    """

    accel: Array
    late: float
    late_std: float
    drift: float
    hidden: float = DRIVING_SPEED


class OtherSignal(Struct, frozen=True):
    """What another signal says of one that may be stuck, of the ticks (N,) that are looked at.

    said: (2, N) by how much the signal has risen up to each tick, and fallen, in its unit, beyond
    what it shows; NaN where the other one says nothing. least: a stuck signal has changed by so
    much and by `steps` of its own changes. origin: (2,) from where the next call counts what is
    said. since: ticks before a run that say what it begins from.
    """

    said: Array
    least: float
    steps: float
    origin: Array
    since: int = 0


def by_force(seen: SeenForward, rows: Array, leaving: int) -> OtherSignal:
    """The force as witness of the speed [m/s] of ticks (N, COLUMNS): what it adds up to, less what
    it may be off, and less what the speed shows."""
    n = len(seen.accel)
    gained = np.concatenate([[0.0], np.cumsum(seen.accel) * TICK_S])
    gained = np.interp(np.arange(1, n + 1) - seen.late / TICK_S, np.arange(n + 1), gained)
    at = np.flatnonzero(rows[:, tk.SPEED.n] > 0)
    if len(at):
        speed = rows[at, tk.SPEED.mean]
        gained -= np.interp(np.arange(n), at, speed - speed[0])
    drift = seen.drift * TICK_S * np.arange(1, n + 1)
    said = np.stack([gained - drift, -gained - drift])
    least = GAINED + seen.hidden + HARD * DEVIATIONS * seen.late_std
    return OtherSignal(said, least, 1.0, said[:, leaving - 1], BEFORE_RUN)


def by_turning(turning: Array, driving: Flags) -> OtherSignal:
    """Another yaw rate (N,) [rad/s] as witness of the yaw rate, where that is driving."""
    turned = np.where(driving, np.convolve(turning, SMOOTH, mode="same"), math.nan)
    return OtherSignal(np.stack([turned, -turned]), TURNED, STEPS, np.zeros(2))


class _OpenRun(Struct, frozen=True):
    """A run that goes on with the next call.

    lasted: (2,) ticks that were driven in it, and in which the witness spoke. low: (2,) least of
    what was said, from the next call's origin. gained: largest change that was said.
    """

    value: float
    lasted: Array
    low: Array
    gained: float
    is_stuck: bool


_NO_RUN = _OpenRun(math.nan, np.zeros(2), np.full(2, math.nan), 0.0, False)


class StuckSignal:
    """Flags ticks at which a signal of the vehicle stays while another says that it has changed.

    A coarse signal keeps a value while its vehicle keeps its speed, or its direction, for minutes;
    a sender that repeats each value some times has long runs all the time. So a run, of zeros as
    well, is held against another signal within it, and a speed as it begins; a sender that repeats
    is given four of its usual runs. Where there is no witness nothing is called stuck: then nothing
    rests on the signal either.

    count, mean: columns of its samples' number and of their mean. same: values that differ by no
    more than that are equal.
    """

    def __init__(self, count: int, mean: int, same: float) -> None:
        self._count, self._mean, self._same = count, mean, same
        self._ended = UsualRuns()
        """How long was driven in them [ticks], the change after."""
        self.restart()

    def take_usual(self, former: StuckSignal) -> None:
        """Take the runs that another one has seen end."""
        self._ended = former._ended

    def restart(self) -> None:
        """Time jumped: the run before is over."""
        self._open = _NO_RUN

    def flags(
        self, rows: Array, driving: Flags, leaving: int, witness: OtherSignal | None
    ) -> Flags:
        """Ticks (N,) at which the signal is stuck; rows: (N, COLUMNS), `leaving` leave next.

        driving: (N,) where the vehicle drives: other ticks do not count as usual.
        """
        out = np.zeros(len(rows), dtype=bool)
        at = np.flatnonzero(rows[:, self._count] > 0)
        if not len(at):
            return out
        values = rows[at, self._mean]
        first, last, change = runs_of(values, self._same)
        begins, ends = at[first], at[last]
        count = np.zeros((2, len(rows) + 1))
        np.cumsum(driving, out=count[0, 1:])
        if witness is not None:
            np.cumsum(np.isfinite(witness.said[0]), out=count[1, 1:])
        lasted = count[:, ends + 1] - count[:, begins]
        before = self._open if abs(values[0] - self._open.value) <= self._same else _NO_RUN
        lasted[:, 0] += before.lasted
        stuck = lasted[1] > MIN_STUCK_S / TICK_S
        if np.count_nonzero(stuck):
            stuck &= lasted[1] > self._limit()
        if before.is_stuck:
            stuck[0] = True

        def begun(i: int) -> _OpenRun:
            if witness is None or (i == 0 and before is not _NO_RUN):
                return before if i == 0 else _NO_RUN
            return replace(_NO_RUN, low=_begins_from(witness, at[: first[i]], out))

        for i in np.flatnonzero(stuck).tolist():
            run, part = begun(i), slice(begins[i], ends[i] + 1)
            stuck[i] = run.is_stuck or self._has_changed(witness, part, run)
            out[part] |= stuck[i]
        over = ~stuck & (ends < leaving) & (lasted[0] > 0.0)
        over[-1] = False
        after = last[over]
        until_next = count[0, at[after + 1]] - count[0, at[after] + 1]
        self._ended.add(lasted[0, over] + until_next, change[after])
        crossing = np.flatnonzero((begins < leaving) & (leaving <= ends))
        if not len(crossing):
            self.restart()
            return one_more(out)
        i = int(crossing[0])
        run = begun(i)
        low, gained = np.full(2, math.nan), run.gained
        if witness is not None:
            low, gained = _changes(witness, slice(begins[i], leaving), run)
            low = low - witness.origin
        so_far = run.lasted + count[:, leaving] - count[:, begins[i]]
        self._open = _OpenRun(float(values[first[i]]), so_far, low, gained, bool(stuck[i]))
        return one_more(out)

    def take_short_runs(self, first: float, driven: Array, change: Array) -> bool:
        """Take ticks all of which have a signal that keeps no value for long, see `short_runs`.

        first: their first value. driven: (M,) of the runs while driving [ticks]; change: (M,) of
        the value. False: the first of them goes on from before, and `flags` has to look.
        """
        if abs(first - self._open.value) <= self._same:
            return False
        self._ended.add(driven, change)
        self.restart()
        return True

    def _limit(self) -> float:
        """A run of more ticks may be stuck; none, until the signal is known."""
        if not self._ended.known:
            return math.inf
        return max(MIN_STUCK_S / TICK_S, TIMES_USUAL * self._ended.repeated(SPLIT, JUMPS))

    def _has_changed(self, witness: OtherSignal | None, part: slice, run: _OpenRun) -> bool:
        if witness is None:
            return False
        least = witness.least + witness.steps * self._ended.change(LARGE)
        return _changes(witness, part, run)[1] > least


def _changes(witness: OtherSignal, part: slice, run: _OpenRun) -> tuple[Array, float]:
    """Lowest of what was said (2,) and largest change, of a run's ticks and those before."""
    said = witness.said[:, part]
    lowest = np.fmin(np.fmin.accumulate(said, axis=1), run.low[:, None])
    return lowest[:, -1], float(np.fmax.reduce(said - lowest, axis=None, initial=run.gained))


def _begins_from(witness: OtherSignal, at: Places, stuck: Flags) -> Array:
    """What a run begins from (2,), of the ticks before it that have a sample (M,): the highest, so
    that no single value makes the next ones wrong; NaN: nothing."""
    near = at[at >= at[-1] - witness.since] if len(at) and witness.since else at[:0]
    near = near[~stuck[near]]
    return np.asarray(witness.said[:, near].max(axis=1)) if len(near) else np.full(2, math.nan)


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
