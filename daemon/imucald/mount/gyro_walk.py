"""Random walk of an angle that is summed from a gyroscope with few samples.

Such a sensor measures the rate at an instant, and not its mean since the previous sample. A
vibration faster than half of the sample rate then looks like slow turning (aliasing). The errors
add up: the angle walks by the sum of h_i e_i. Here e_i is the part of a sample that is independent
of its neighbours, and h_i is the time for which the sample stands. The samples themselves show the
size of e. A sample differs from the line between its neighbours by r_i = e_i - a e_(i-1) - b
e_(i+1), a + b = 1, so that E[r r'] = (1 + a^2 + b^2) E[e e']. Real quick turning is included, so
the walk is estimated too large rather than too small.
"""

from __future__ import annotations

import numpy as np

from imucald.core.arrays import Array


def sampling_walk(times: Array, rates: Array, counts: Array, longest: float) -> Array:
    """Return the growth of the angle's variance (3, 3) [rad^2/s] from means (M, 3) [rad/s] of
    counts (M,) samples at times (M,).

    Only single samples are instants: zero if all means are of several. longest: longer holes are
    not bridged [s].
    """
    if len(times) < 3:
        return np.zeros((3, 3))
    gaps = np.diff(times)
    before, after = gaps[:-1], gaps[1:]
    stands_for = 0.5 * (before + after)
    use = (counts[1:-1] < 2) & (np.maximum(before, after) <= longest)
    if not np.count_nonzero(use):
        return np.zeros((3, 3))
    b = before[use] / (before[use] + after[use])
    a = 1.0 - b
    left = rates[1:-1][use] - a[:, None] * rates[:-2][use] - b[:, None] * rates[2:][use]
    weight = stands_for[use] ** 2 / (1.0 + a * a + b * b)
    out: Array = (left * weight[:, None]).T @ left / float(stands_for.sum())
    return out
