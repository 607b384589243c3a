"""Random walk of an angle that is integrated from a gyroscope with few samples.

Such a sensor measures the rate at an instant, and not the mean rate since the previous sample. A
vibration faster than half of the sample rate then looks like slow turning (aliasing). The errors
add up: the error of the angle is the sum of h_i e_i. Here e_i is the part of a sample that is
independent of its neighbours, and h_i is the time between the middles of the two neighbouring gaps.
The size of e is computed from the samples. A sample differs from the line between its neighbours by
r_i = e_i - a e_(i-1) - b e_(i+1), a + b = 1, so that E[r r'] = (1 + a^2 + b^2) E[e e']. Real quick
turning increases r, so the walk is estimated too large rather than too small.
"""

from __future__ import annotations

import numpy as np

from imucald.core.arrays import Array


def sampling_walk(times: Array, rates: Array, counts: Array, longest: float) -> Array:
    """Return the growth of the angle's variance (3, 3) [rad^2/s].

    times: (M,) [s]. rates: mean rates (M, 3) [rad/s], each of `counts` (M,) samples. Only a mean of
    a single sample is a measurement at an instant, so the result is zero if there are no such
    means. longest: longer holes are not bridged [s].
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
