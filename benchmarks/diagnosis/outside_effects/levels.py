"""Changed samples on the levels that a sensor has."""

from __future__ import annotations

import numpy as np

from benchmarks.diagnosis.real_effects import Array, Drive
from imucald.core.samples import Series


def set_values(s: Drive, name: str, values: Array) -> None:
    """In the sensor's own levels: what acts on it acts before its converter."""
    old = s[name].values.reshape(len(values), -1).T
    new = values.reshape(len(values), -1).T
    columns = [_on_levels(x, y) for x, y in zip(old, new, strict=True)]
    s[name] = Series(s[name].t, np.column_stack(columns).reshape(values.shape))


def _on_levels(old: Array, new: Array) -> Array:
    levels = np.unique(old)
    if len(levels) < 3:
        return new
    step = float(np.quantile(np.diff(levels), 0.1))
    return np.asarray(levels[0] + np.round((new - levels[0]) / step) * step)
