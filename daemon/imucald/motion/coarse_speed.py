"""A speed in coarse steps, as what it says: when it passed the middle between two of them.

A signal that is rounded to steps s keeps a value while the true speed is within s / 2 of it, and
goes on to the next when it passes the middle. Taken as they are, the values make dv/dt zero for
most of the time and a spike now and then, which no force follows; straight lines between the
passages are off by s / 2 at most, and are right where they are crossed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imucald.motion.ticks import TICK_S

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

SAME_SPEED = 1e-6
"""Means over different numbers of equal speeds differ by rounding [m/s]."""
COARSE = 0.02
"""Finer steps [m/s] make less noise of dv/dt, within two ticks, than a road makes of the force."""
SMALL = 0.15
"""A change of less than so much of the step is none of a speed in steps, but for the first or last
of ten samples of a tick."""
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


def passages(times: Array, values: Array) -> tuple[Array, Array]:
    """Times (M,) and speeds (M,) that straight lines go through, of ticks' mean speeds (N,).

    Standstill stays as it is, and so does what changes by more than a step from tick to tick.
    """
    step = step_of(values)
    if step < COARSE:
        return times, values
    change = np.diff(values)
    is_next = np.abs(change) <= ONE_STEP * step
    moved = np.abs(change) > SAME_SPEED
    # of a tick in which the speed changes: both neighbours a step apart, and its mean between them
    mixed = np.zeros(len(values), dtype=bool)
    over = values[2:] - values[:-2]
    part = (values[1:-1] - values[:-2]) / np.where(np.abs(over) > SAME_SPEED, over, 1.0)
    is_step = np.abs(np.abs(over) - step) <= 0.1 * step
    mixed[1:-1] = is_step & (part > 0.01) & (part < 0.99)
    mixed[1:] &= ~mixed[:-1]
    at = np.flatnonzero(mixed)
    in_tick = times[at] + (0.5 - part[at - 1]) * TICK_S
    middle = 0.5 * (values[at - 1] + values[at + 1])
    # between two ticks
    crossed = moved & is_next & ~mixed[1:] & ~mixed[:-1]
    between = np.flatnonzero(crossed)
    # values that are no passage
    kept = np.zeros(len(values), dtype=bool)
    kept[0] = kept[-1] = True
    kept[1:] |= ~is_next
    kept[:-1] |= ~is_next
    kept |= np.abs(values) <= SAME_SPEED
    kept &= ~mixed
    t = np.concatenate([times[kept], in_tick, 0.5 * (times[between] + times[between + 1])])
    v = np.concatenate([values[kept], middle, 0.5 * (values[between] + values[between + 1])])
    order = np.argsort(t, kind="stable")
    return t[order], v[order]
