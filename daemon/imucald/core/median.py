"""The median of a list. numpy's imports its masked arrays, which takes 20 ms of every start."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np


def median(values: Iterable[float]) -> float:
    """Return the median; of an even number the mean of the middle two. ValueError: no value."""
    ordered = values if isinstance(values, np.ndarray) else sorted(values)
    if not len(ordered):
        raise ValueError("no value has no median")
    middle = len(ordered) // 2
    if isinstance(ordered, np.ndarray):  # as far as it matters
        ordered = np.partition(ordered, (max(middle - 1, 0), middle))
    if len(ordered) % 2:
        return float(ordered[middle])
    return float((ordered[middle - 1] + ordered[middle]) / 2.0)
