"""Join tables with different rates in one table with a common rate, by averaging or
interpolation."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from imucald.api.columns import TIMES, Columns, TableColumn, columns_from
from imucald.core.arrays import Array
from imucald.core.errors import ImucaldError

WINDOW_PERIODS = 4.0
"""Length of the Hann window in periods of the new rate. The first zero of its spectrum is at 2 /
length, half the new rate. Above this frequency, the spectrum is below -31 dB (Harris, Proc. IEEE
66, 1978)."""
HOLE_PERIODS = 2.5
"""Smallest time between two samples that counts as a hole, in usual periods. The value corresponds
to two lost samples minus some jitter."""
MAX_ROWS = 50_000_000
"""Largest number of rows of a resampled table.

A request for more rows shows that the stated rate is a mistake.
"""


def resampled(tables: Mapping[str, Columns], rate_hz: float) -> Columns:
    """Return the tables' numbers at whole multiples of 1 / rate_hz; see `TableAccess.resample`."""
    if not (rate_hz > 0.0 and math.isfinite(rate_hz)):
        raise ImucaldError(f"a rate must be positive, not {rate_hz:g} Hz")
    if not tables:
        raise ImucaldError("name at least one table to resample")
    chosen = {name: _numbers(name, table) for name, table in tables.items()}
    spans = [t[[0, -1]] for t in (table["t_s"] for table in tables.values()) if len(t)]
    grid = np.zeros(0)
    if spans:
        first = math.ceil(min(s[0] for s in spans) * rate_hz)
        last = math.floor(max(s[1] for s in spans) * rate_hz)
        if last - first > MAX_ROWS:
            raise ImucaldError(f"{rate_hz:g} Hz would make {last - first} rows")
        grid = np.arange(first, last + 1) / rate_hz
    columns, arrays = [TIMES[0]], [grid]
    for name, found in chosen.items():
        t = tables[name]["t_s"]
        values = np.stack([tables[name][c.name] for c in found], axis=1)
        columns += found
        arrays += list(_on_grid(t, values, grid, rate_hz).T)
    return columns_from(tuple(columns), list(arrays))


def _numbers(name: str, table: Columns) -> list[TableColumn]:
    found = [
        c for c in table.columns if c.kind == "float" and c.name not in ("t_s", "time", "quality")
    ]
    if not found or any(c.kind == "text" for c in table.columns):
        raise ImucaldError(f"{name} is not a table of samples, so it cannot be resampled")
    return found


def _on_grid(t: Array, values: Array, grid: Array, rate_hz: float) -> Array:
    """Resample values (N, k) at the times t (N,) to the times `grid` (M,). The result is (M, k),
    with NaN in holes."""
    known = ~np.isnan(values).any(axis=1)
    t, values = t[known], values[known]
    nothing = np.full((len(grid), values.shape[1]), math.nan)
    if len(t) < 2:
        return nothing
    steps = np.diff(t)
    moving = steps[steps > 0.0]
    if not len(moving):
        return nothing
    period = float(np.median(moving))
    after = np.clip(np.searchsorted(t, grid), 1, len(t) - 1)
    hole = (t[after] - t[after - 1] > HOLE_PERIODS * period) & (grid != t[after - 1])
    outside = (grid < t[0]) | (grid > t[-1])
    found = (
        _averaged(t, values, grid, WINDOW_PERIODS / rate_hz)
        if period * rate_hz < 1.0
        else _interpolated(t, values, grid)
    )
    found[(hole & (grid != t[after])) | outside] = math.nan
    return found


def _interpolated(t: Array, values: Array, grid: Array) -> Array:
    return np.stack([np.interp(grid, t, column) for column in values.T], axis=1)


def _averaged(t: Array, values: Array, grid: Array, length: float) -> Array:
    """Average the values with a Hann window of the given length [s] around each time of the
    grid."""
    low = np.searchsorted(t, grid - 0.5 * length, side="right")
    high = np.searchsorted(t, grid + 0.5 * length, side="left")
    total = np.zeros((len(grid), values.shape[1]))
    weights = np.zeros(len(grid))
    for step in range(int((high - low).max(initial=0))):
        row = np.minimum(low + step, len(t) - 1)
        phase = (t[row] - grid) * (2.0 * math.pi / length)
        weight = np.where(low + step < high, 1.0 + np.cos(phase), 0.0)
        total += weight[:, None] * values[row]
        weights += weight
    with np.errstate(invalid="ignore", divide="ignore"):
        return total / weights[:, None]
