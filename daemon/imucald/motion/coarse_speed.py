"""Convert a speed in coarse steps to the times at which it passed the middle between two steps.

A signal that is rounded to steps s keeps a value while the true speed is within s / 2 of it. The
signal changes to the next value when the true speed passes the middle. Used directly, the values
make dv/dt zero for most of the time with a spike now and then, which no force follows. Straight
lines between the passages are wrong by at most s / 2, and exact at the passages. Noise makes the
signal alternate around a passage. The passage is where most samples of a tick have passed.
"""

from __future__ import annotations

import numpy as np

from imucald.core.arrays import Array, Flags
from imucald.motion.ticks import TICK_S

SAME_SPEED = 1e-6
"""Difference by rounding between means over different numbers of equal speeds [m/s]."""
COARSE = 0.02
"""Smallest step that counts as coarse [m/s].

Finer steps cause less noise in dv/dt over two ticks than a road causes in the force.
"""
SMALL = 0.15
"""A change of less than this share of the step is not a step, except for the first or last of ten
samples of a tick.
"""
ON_STEP, MOST_OFF = 1e-3, 0.1
"""A mean within this share of a step counts as on the step, up to rounding.

At most this share of ticks may hold a sample of another sender or a wrong value.
"""
ONE_STEP = 1.5
"""Values at most this many steps apart are neighbours."""


def stays(values: Array) -> Flags:
    """Return whether any of speeds (B, M) stays equal from one tick to the next, apart from
    standstill (B,).
    """
    same = np.abs(values[:, 1:] - values[:, :-1]) <= SAME_SPEED
    return np.asarray((same & (np.abs(values[:, 1:]) > SAME_SPEED)).any(axis=1))


def step_of(values: Array) -> float:
    """Return the step of speeds (N,) [m/s]: the smallest change between two speeds that stay; 0: no
    step is visible.

    If a coarse speed changes within a tick, the mean lies between its steps and does not stay. A
    fine speed stays while the vehicle keeps its speed, but most of its changes are small.
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
    """Return whether mean speeds (N,) of this many samples (N,) each come from a signal with this
    step [m/s].

    The sum of a tick's samples is then a whole number of steps.
    """
    whole = values * counts / step
    off = np.abs(whole - np.rint(whole)) > ON_STEP * counts
    return bool(np.count_nonzero(off) < MOST_OFF * len(off))


def passages(times: Array, values: Array, step: float) -> tuple[Array, Array]:
    """Return times (M,) and speeds (M,) of the points that straight lines connect, from ticks' mean
    speeds (N,) in steps [m/s].

    Standstill is kept, and so are changes by more than a step from tick to tick.
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
    # If a tick has samples of both steps, its mean shows for which part of the tick each was sent.
    before = np.clip((steps[at] - nearest[at]) * over[at], 0.0, 0.5)
    after = np.clip((nearest[at + 1] - steps[at + 1]) * over[at], 0.0, 0.5)
    when = 0.5 * (times[at] + times[at + 1]) + (after - before) * TICK_S
    middle = level + step * 0.5 * (nearest[at] + nearest[at + 1])
    # Values that are not passages.
    kept = np.abs(values) <= SAME_SPEED
    kept[0] = kept[-1] = True
    kept[1:] |= ~is_next
    kept[:-1] |= ~is_next
    t, v = np.concatenate([times[kept], when]), np.concatenate([values[kept], middle])
    order = np.argsort(t, kind="stable")
    return t[order], v[order]
