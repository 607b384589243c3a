"""Convert a speed with a coarse step size to the times at which it passed the middle between two
steps.

A signal that is rounded to a step size s keeps a value while the true speed is within s / 2 of this
value. The signal changes to the next value when the true speed passes the middle between the two
values. If the values are used directly, dv/dt is zero most of the time and has a spike at each
step. The accelerometer shows no such spikes. Straight lines between the passages have an error of
at most s / 2, and no error at the passages. With noise, the signal alternates around a passage. The
time of the passage is then computed from the mean of the samples in a tick.
"""

from __future__ import annotations

import numpy as np

from imucald.core.arrays import Array, Flags
from imucald.motion.ticks import TICK_S

SAME_SPEED = 1e-6
"""Difference between means over different numbers of equal speeds that comes from rounding
[m/s]."""
COARSE = 0.02
"""Smallest step size that counts as coarse [m/s].

A smaller step size causes less noise in dv/dt over two ticks than a road causes in the force.
"""
SMALL = 0.15
"""Share of the step size below which a change is not a step. Exception: a change that only the
first or last of ten samples of a tick shows.
"""
ON_STEP, MOST_OFF = 1e-3, 0.1
"""Tolerances for values on a step. Up to rounding, a mean within `ON_STEP` of a step counts as on
the step. At most the share `MOST_OFF` of all ticks may contain a sample of another sender or a
wrong value.
"""
ONE_STEP = 1.5
"""Distance, in steps, up to which two values are neighbours."""


def stays(values: Array) -> Flags:
    """Return flags (B,): True if the speeds (B, M) are equal in two successive ticks outside
    standstill.
    """
    same = np.abs(values[:, 1:] - values[:, :-1]) <= SAME_SPEED
    return np.asarray((same & (np.abs(values[:, 1:]) > SAME_SPEED)).any(axis=1))


def step_of(values: Array) -> float:
    """Return the step size of speeds (N,) [m/s]: the smallest change between two speeds that each
    last for more than one tick. 0: no step size is visible.

    If a coarse speed changes within a tick, the mean of the tick lies between two steps and does
    not last. A fine speed lasts while the vehicle keeps its speed, but most changes of a fine speed
    are small.
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
    """Return whether mean speeds (N,) come from a signal with this step size [m/s].

    counts: (N,) number of samples of each mean. If the speeds come from such a signal, the sum of
    the samples of a tick is a whole number of steps.
    """
    whole = values * counts / step
    off = np.abs(whole - np.rint(whole)) > ON_STEP * counts
    return bool(np.count_nonzero(off) < MOST_OFF * len(off))


def passages(times: Array, values: Array, step: float) -> tuple[Array, Array]:
    """Return the times (M,) [s] and speeds (M,) [m/s] of the passages from mean speeds (N,) of
    ticks. The speed between two passages is a straight line.

    Values at standstill are kept. Changes by more than one step from tick to tick are also kept.
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
