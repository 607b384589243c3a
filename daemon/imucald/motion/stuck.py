"""Stuck signals: a sensor or a sender that repeats one value.

The error of a stuck signal is the change of the true value, and the signal jumps when it is no
longer stuck. A run of equal means over ticks is compared with what another signal shows meanwhile
(`StuckSignal`; for method A tick by tick: `HeldForce`). `sample_health` judges the samples of a
sensor without another signal.
`model_compensation.held_repeats` does not look for stuck sensors: it keeps a stuck sensor
recognisable.

`EqualRuns` holds the places of the runs of equal values, `UsualChanges` the size of the changes
between them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from imucald.core.arrays import Array, Flags
from imucald.core.rotations import Vector
from imucald.motion import ticks as tk
from imucald.motion.coarse_speed import SAME_SPEED
from imucald.motion.standstill import DRIVING_SPEED, ROLLING_SPEED
from imucald.motion.ticks import ACCEL, TICK_S, TickRow

Places = NDArray[np.int64]

MIN_STUCK_TICKS = 12
"""Longest run of equal values, in ticks of 0.1 s, that is never stuck."""
RUNS_REMEMBERED = 200
MIN_RUNS = 50
"""Number of runs after which a signal that may repeat its values can count as stuck."""


class EqualRuns(NamedTuple):
    """Runs of equal values.

    first, last: (M,) places of the first and last value of each run. change: (N - 1,) size of the
    change after each value.
    """

    first: Places
    last: Places
    change: Array


def runs_of(values: Array, same: float) -> EqualRuns:
    """Return the runs in values (N, axes), N > 0. No axis of neighbouring values in a run differs
    by more than `same`."""
    change = np.abs(values[1:] - values[:-1]).max(axis=1)
    ended = np.flatnonzero(change > same)
    first, last = np.zeros((2, len(ended) + 1), np.int64)
    first[1:], last[:-1], last[-1] = ended + 1, ended, len(values) - 1
    return EqualRuns(first, last, change)


class UsualChanges:
    """The changes after the last RUNS_REMEMBERED runs that ended."""

    def __init__(self) -> None:
        self._changes = np.zeros(RUNS_REMEMBERED)
        self._ended = 0

    def add_changes(self, changes: Array) -> None:
        """Store the changes (M,) after runs."""
        self._changes[(self._ended + np.arange(len(changes))) % RUNS_REMEMBERED] = changes
        self._ended += len(changes)

    @property
    def known(self) -> bool:
        """True if enough runs have ended to know the usual change."""
        return self._ended >= MIN_RUNS

    def most(self, share: float) -> float:
        """Return the change that this share of all changes does not exceed (`numpy.quantile`, which
        imports masked arrays: 7 ms, 1.2 MiB)."""
        ordered = np.sort(self._changes[: self._ended])
        place = share * (len(ordered) - 1)
        low = int(place)
        high = min(low + 1, len(ordered) - 1)
        return float(ordered[low] + (place - low) * (ordered[high] - ordered[low]))


BEFORE_RUN = 12
"""Number of ticks before a run whose speeds show the value at which the run begins."""
ROLLED_TICKS = 3.5
"""Number of ticks with a rolling vehicle within a run, after its first tick, from which a sensor is
stuck: noise always changes its values."""
HELD_TICKS = 10
"""Number of ticks (a second) with the same force, also within each tick, from which the force is
stuck."""
SAME = 1e-9
"""Difference between means over nine and ten equal samples that comes from rounding [m/s^2,
rad/s]."""
TURNED, STEPS = 0.008, 3.0
"""Smallest change of the other yaw rate at which a yaw rate is stuck: `TURNED` [rad/s] plus `STEPS`
of the signal's own steps.

`TURNED` is 3 deg in the 6.4 s of a block, which would look like a rotation of the sensor. Rounding
holds a value back by one step, and a sender's dead band holds a value back by two steps.
"""
SMOOTH = np.full(10, 0.1)
"""Weights of a mean over a second. The other yaw rate is averaged because vibration is not a
turn."""
LARGE = 0.9
"""Quantile of the changes that is used as the possible error of a signal, because means over ticks
split steps."""
GAINED = 1.5
"""Additional possible error [m/s]. The cause is the response of the body and of the vertical to
hard braking."""
HARD, DEVIATIONS = 2.0, 3.0
"""Braking [m/s^2], and possible time error in deviations of the speed's delay. While the delay is
not known, a braking may be earlier by this time.
"""
TURNING_WHEELS = 15
"""Number of ticks with turning wheels and zero speed from which the speed is stuck.

A speed that begins at 4 km/h (inductive wheel sensors) is zero for the first second of a launch at
1 m/s^2.
"""
WHEELS_WITHIN = np.ones(41)
"""Window of 2 s before and after a tick, in which ticks with turning wheels are counted. Coarse
wheel speeds do not change in every tick.
"""


def latest_speed(rows: Array) -> Array:
    """Return the absolute value of the last received speed for each of the ticks (N, COLUMNS); NaN
    before the first speed.
    """
    received = rows[:, tk.SPEED.n] > 0
    latest = np.maximum.accumulate(np.where(received, np.arange(len(rows)), 0))
    return np.asarray(np.where(received[latest], np.abs(rows[latest, tk.SPEED.mean]), math.nan))


class HeldForce:
    """Counts ticks with the same force. The force must also be constant within each tick."""

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Restart after a jump of time."""
        self._force: Vector | None = None
        self._ticks = 0

    def take_tick(self, tick: TickRow, force: Vector) -> bool:
        """Process a tick and its mean force. Returns whether the force is stuck, provided that the
        vehicle moves."""
        same = force == self._force and tick[ACCEL.min_x] == tick[ACCEL.max_x]
        self._ticks = self._ticks + 1 if same else 0
        self._force = force
        return self._ticks >= HELD_TICKS


def one_more(flags: Flags) -> Flags:
    """Return the flags, extended by the tick after each flagged tick."""
    out = flags.copy()
    out[1:] |= flags[:-1]
    return out


class SeenForward(Struct, frozen=True):
    """Evidence of the accelerometer about the speed, for the ticks (N,) in use.

    accel: forward force without gravity [m/s^2]. late: delay of the speed against the force [s].
    late_std: deviation of this delay [s]. drift: lasting error of the force [m/s^2]. hidden: speed
    up to which the vehicle may creep while its speed signal is zero [m/s].
    """

    accel: Array
    late: float
    late_std: float
    drift: float
    hidden: float = DRIVING_SPEED


class OtherSignal(Struct, frozen=True):
    """Evidence of another signal about a signal that may be stuck, for the ticks (N,) in use.

    said: (2, N) expected rise and expected fall of the signal up to each tick, in its unit, beyond
    its own change; NaN if the other signal gives no evidence. least: change from which the signal
    is stuck. steps: number of the signal's own changes that are added to `least`. origin: (2,)
    value at which the next call begins to count. since: number of ticks before a run that show the
    value at which the run begins.
    """

    said: Array
    least: float
    steps: float
    origin: Array
    since: int = 0


def by_force(seen: SeenForward, rows: Array, leaving: int) -> OtherSignal:
    """Return the force as evidence about the speed [m/s] of ticks (N, COLUMNS).

    The evidence is the integral of the force, minus its possible error and minus the change of the
    speed signal.
    """
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


def by_rolling(rows: Array, leaving: int, moving: bool) -> OtherSignal:
    """Return the number of ticks with a rolling vehicle, in ticks (N, COLUMNS), as evidence about a
    sensor: noise always changes its values, but a coarse sensor may repeat a value at rest.

    moving: True if a vehicle without a received speed counts as moving.
    """
    speed = latest_speed(rows)
    known = np.isfinite(speed[-1])
    rolled = np.cumsum(speed > ROLLING_SPEED if known else np.full(len(rows), moving), dtype=float)
    said = np.stack([rolled, np.zeros(len(rows))])
    return OtherSignal(said, ROLLED_TICKS, 0.0, said[:, leaving - 1])


def by_turning(turning: Array, driving: Flags) -> OtherSignal:
    """Return another yaw rate (N,) [rad/s] as evidence about the yaw rate. Only ticks with the flag
    `driving` are used.
    """
    turned = np.where(driving, np.convolve(turning, SMOOTH, mode="same"), math.nan)
    return OtherSignal(np.stack([turned, -turned]), TURNED, STEPS, np.zeros(2))


class _OpenRun(Struct, frozen=True):
    """A run that continues in the next call.

    value: (axes,) value of the run. lasted: (2,) number of driving ticks in the run, and number of
    ticks with evidence from the other signal. low: (2,) smallest evidence, relative to the origin
    of the next call. gained: largest change according to the other signal.
    """

    value: Array
    lasted: Array
    low: Array
    gained: float
    is_stuck: bool


_NO_RUN = _OpenRun(np.full(1, math.nan), np.zeros(2), np.full(2, math.nan), 0.0, False)


class StuckSignal:
    """Flags ticks at which a signal stays constant while another signal shows a change.

    A sensor's values always change because of noise, so the other signal is that the vehicle rolls
    (`by_rolling`). A coarse signal of the vehicle keeps a value for minutes while the vehicle keeps
    its speed or direction, so it is compared with a signal that measures the same (`by_force`,
    `by_turning`), within a usual change of its own. A run of the speed is also compared with the
    ticks before the run. A signal that got stuck before the vehicle stopped is flagged at rest too.
    Without another signal, the signal is never stuck. The tick after a stuck run is flagged as
    well, because its mean may contain stuck samples.

    count: column of the signal's number of samples. means: columns of its means. same: largest
    difference between two equal values. repeats: True if sound senders may repeat values.
    """

    def __init__(self, count: int, means: slice, same: float, repeats: bool = True) -> None:
        self._count, self._means, self._same = count, means, same
        self._repeats = repeats
        self._usual = UsualChanges()
        self.restart()

    def take_usual(self, former: StuckSignal) -> None:
        """Copy the usual changes of another object."""
        self._usual = former._usual

    def restart(self) -> None:
        """Restart after a jump of time: the open run ends."""
        self._open = _NO_RUN

    def flags(
        self, rows: Array, driving: Flags, leaving: int, other: Callable[[], OtherSignal | None]
    ) -> Flags:
        """Return flags of the ticks (N,) at which the signal is stuck.

        rows: (N, COLUMNS). leaving: number of first rows that the next call does not contain.
        driving: (N,) flags of the ticks in which the vehicle drives. Runs in other ticks do not
        count for the usual changes. other: gives the evidence of the other signal, or None. It is
        asked only if there is a long run, or a run that an earlier or the next call also contains.
        """
        out = np.zeros(len(rows), dtype=bool)
        at = np.flatnonzero(rows[:, self._count] > 0)
        if not len(at):
            return out
        values = rows[at, self._means]
        first, last, change = runs_of(values, self._same)
        begins, ends = at[first], at[last]
        before = self._open if self._goes_on(values[0]) else _NO_RUN
        crossing = np.flatnonzero((begins < leaving) & (leaving <= ends))
        is_asked = (
            before is not _NO_RUN or len(crossing) or (ends - begins).max() >= MIN_STUCK_TICKS
        )
        if not is_asked and not self._repeats:
            self.restart()
            return out
        witness = other() if is_asked else None
        count = np.zeros((2, len(rows) + 1))
        np.cumsum(driving, out=count[0, 1:])
        if witness is not None:
            np.cumsum(np.isfinite(witness.said[0]), out=count[1, 1:])
        lasted = count[:, ends + 1] - count[:, begins]
        lasted[:, 0] += before.lasted
        stuck = lasted[1] > MIN_STUCK_TICKS
        stuck &= self._usual.known or not self._repeats
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
        self._usual.add_changes(change[last[over]])
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
        self._open = _OpenRun(values[first[i]], so_far, low, gained, bool(stuck[i]))
        return one_more(out)

    def _goes_on(self, value: Array) -> bool:
        return bool((np.abs(value - self._open.value) <= self._same).all())

    def _has_changed(self, witness: OtherSignal | None, part: slice, run: _OpenRun) -> bool:
        if witness is None:
            return False
        least = witness.least
        if witness.steps:
            least += witness.steps * self._usual.most(LARGE)
        return _changes(witness, part, run)[1] > least


def _changes(witness: OtherSignal, part: slice, run: _OpenRun) -> tuple[Array, float]:
    """Return the smallest evidence (2,) and the largest change, over the ticks of this call and
    earlier ticks of the run.
    """
    said = witness.said[:, part]
    lowest = np.fmin(np.fmin.accumulate(said, axis=1), run.low[:, None])
    return lowest[:, -1], float(np.fmax.reduce(said - lowest, axis=None, initial=run.gained))


def _begins_from(witness: OtherSignal, at: Places, stuck: Flags) -> Array:
    """Return the value (2,) at which a run begins; NaN: no evidence.

    The value is the highest evidence of the ticks with a sample (M,) before the run. A single wrong
    value therefore does not affect the next values.
    """
    near = at[at >= at[-1] - witness.since] if len(at) and witness.since else at[:0]
    near = near[~stuck[near]]
    return np.asarray(witness.said[:, near].max(axis=1)) if len(near) else np.full(2, math.nan)


def zero_while_wheels_turn(rows: Array) -> Flags:
    """Return flags of the ticks (N,) that have a speed of zero although the wheels turn nearby.
    rows: (N, COLUMNS).

    The speed of a standing wheel is constant, even with an offset. If the spread between the wheel
    speeds changes from tick to tick, the wheels turn.
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
