"""A speed in coarse steps, as what it says: when it passed the middle between two of them.

A signal that is rounded to steps s keeps a value while the true speed is within s / 2 of it, and
goes on to the next when it passes the middle. Taken as they are, the values make dv/dt zero for
most of the time and a spike now and then, which no force follows; straight lines between the
passages are off by s / 2 at most, and are right where they are crossed. Noise takes the signal to
and fro around a passage: it is where most of the samples of a tick have passed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imucald.core.arrays import Array
from imucald.motion.ticks import TICK_S

Flags = NDArray[np.bool_]

SAME_SPEED = 1e-6
"""Means over different numbers of equal speeds differ by rounding [m/s]."""
COARSE = 0.02
"""Finer steps [m/s] make less noise of dv/dt, within two ticks, than a road makes of the force."""
SMALL = 0.15
"""A change of less than so much of the step is none of a speed in steps, but for the first or last
of ten samples of a tick."""
ON_STEP, MOST_OFF = 1e-3, 0.1
"""A mean is on a step, but for rounding, within that part of it; fewer ticks than that share may
hold a sample of another sender or a wrong value."""
ONE_STEP = 1.5
"""So many steps apart, at most, are neighbours."""


def stays(values: Array) -> Flags:
    """Whether any of speeds (B, M) stays from a tick to the next, but at standstill (B,)."""
    same = np.abs(values[:, 1:] - values[:, :-1]) <= SAME_SPEED
    return np.asarray((same & (np.abs(values[:, 1:]) > SAME_SPEED)).any(axis=1))


def step_of(values: Array) -> float:
    """The step of speeds (N,) [m/s]: the smallest change from one that stays to another; 0: none
    shows.

    The mean over a tick in which a coarse speed changes lies between its steps, and does not stay.
    Of a fine one, which stays while its vehicle does not change its speed, most changes are small.
    """
    change = np.abs(values[1:] - values[:-1])
    moves = change > SAME_SPEED
    last = np.flatnonzero(moves)
    first = np.append(0, last + 1)
    last = np.append(last, len(values) - 1)
    stay = np.flatnonzero((last > first) & (np.abs(values[first]) > SAME_SPEED))
    before, after = stay[:-1], stay[1:]
    next_to = first[after] - last[before] <= 2
    steps = np.abs(values[first[after]] - values[first[before]])[next_to]
    steps = steps[steps > SAME_SPEED]
    if not len(steps):
        return 0.0
    step = float(steps.min())
    small = np.count_nonzero(change[moves] < SMALL * step)
    return step if 2 * small < np.count_nonzero(moves) else 0.0


def comes_in(step: float, values: Array, counts: Array) -> bool:
    """Whether mean speeds (N,) of so many samples (N,) each are of a signal in such steps [m/s].

    The sum of a tick's samples is a whole number of them.
    """
    whole = values * counts / step
    off = np.abs(whole - np.rint(whole)) > ON_STEP * counts
    return bool(np.count_nonzero(off) < MOST_OFF * len(off))


def passages(times: Array, values: Array, step: float) -> tuple[Array, Array]:
    """Times (M,) and speeds (M,) that straight lines go through, of ticks' mean speeds (N,) in
    steps [m/s].

    Standstill stays as it is, and so does what changes by more than a step from tick to tick.
    """
    if step < COARSE:
        return times, values
    stay = values[1:][np.abs(np.diff(values)) <= SAME_SPEED] / step
    phases, counts = np.unique(np.round(stay % 1.0, 3), return_counts=True)
    level = step * float(phases[counts.argmax()]) if len(stay) else 0.0
    steps = (values - level) / step
    nearest = np.rint(steps)
    over = np.diff(nearest)
    is_next = (np.abs(np.diff(steps)) <= ONE_STEP) & (np.abs(over) <= 1.0)
    at = np.flatnonzero(is_next & (over != 0.0))
    # Of a tick with samples of both steps the mean says for how much of it which one was sent.
    before = np.clip((steps[at] - nearest[at]) * over[at], 0.0, 0.5)
    after = np.clip((nearest[at + 1] - steps[at + 1]) * over[at], 0.0, 0.5)
    when = 0.5 * (times[at] + times[at + 1]) + (after - before) * TICK_S
    middle = level + step * 0.5 * (nearest[at] + nearest[at + 1])
    # values that are no passage
    kept = np.abs(values) <= SAME_SPEED
    kept[0] = kept[-1] = True
    kept[1:] |= ~is_next
    kept[:-1] |= ~is_next
    t, v = np.concatenate([times[kept], when]), np.concatenate([values[kept], middle])
    order = np.argsort(t, kind="stable")
    return t[order], v[order]
