"""Align signals of different age, tick by tick, before they reach the estimator.

Each channel is delayed until the channel with the largest latency has arrived. Whole ticks of delay
are made by storing rows. The remaining part of a tick is subtracted from the age that a tick states
for its samples, or the mean is interpolated. A known delay is therefore not estimated again, and
does not disturb parts of the program that cannot handle delays. Only the estimator waits. Samples
are corrected when they arrive.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from imucald.core.samples import FLAGS
from imucald.motion import ticks as tk
from imucald.motion.column_ticks import TickAccumulator
from imucald.motion.ticks import TICK_RATE, TICK_S

MIN_SHIFT_S = 0.001
"""Smallest difference of latency that is corrected [s]."""


@dataclass(frozen=True)
class _Group:
    """Columns of one channel in a row. columns: all columns. age: column of the age (sensors).
    mean: columns of count and mean (signals with one component)."""

    columns: tuple[int, ...]
    age: int | None = None
    mean: tk.SignalColumns | None = None


_GROUPS: Mapping[str, _Group] = {
    "accel": _Group(tk.ACCEL, tk.ACCEL.age),
    "gyro": _Group(tk.GYRO, tk.GYRO.age),
    "speed": _Group(tk.SPEED, tk.SPEED.age),
    "wheel_speeds": _Group(tk.WHEEL_SPREAD, None, tk.WHEEL_SPREAD),
    **{channel: _Group(columns, None, columns) for channel, columns in tk.MEANS.items()},
    **{channel: _Group((tk.LASTS[channel],)) for channel in FLAGS},
}


@dataclass(frozen=True)
class _Shift:
    group: _Group
    whole: int
    rest: float  # part of a tick, 0 .. 1


class TimeAlignment:
    """Receives rows of ticks and returns rows in which all channels belong to the same time.

    shifts: by channel, the time by which the channel is delayed [s].
    """

    def __init__(self, shifts: Mapping[str, float]) -> None:
        self._shifts: list[_Shift] = []
        for channel, group in _GROUPS.items():
            ticks = shifts.get(channel, 0.0) * TICK_RATE
            whole = math.floor(ticks + 1e-9)
            self._shifts.append(_Shift(group, whole, max(ticks - whole, 0.0)))
        self._empty: list[float] = TickAccumulator().close(0)
        self._rows: deque[Sequence[float]] = deque(
            maxlen=max(shift.whole for shift in self._shifts) + 2
        )

    def gap(self) -> None:
        """Restart after a jump of time: stored rows are not joined with later rows."""
        self._rows.clear()

    def row(self, row: Sequence[float]) -> list[float]:
        """Process the row of a tick.

        Returns a row in which every channel is delayed by its shift.
        """
        self._rows.appendleft(row)
        out = list(self._empty)
        out[tk.T] = row[tk.T]
        out[tk.HEADING], out[tk.TEMPERATURE] = row[tk.HEADING], row[tk.TEMPERATURE]
        for shift in self._shifts:
            self._take(shift, out)
        return out

    def _take(self, shift: _Shift, out: list[float]) -> None:
        group, rows = shift.group, self._rows
        whole = shift.whole
        if group.age is None and group.mean is None:
            whole += shift.rest > 0.5
        if whole >= len(rows):
            return
        row = rows[whole]
        for column in group.columns:
            out[column] = row[column]
        if group.age is not None:
            out[group.age] -= shift.rest * TICK_S
        elif group.mean is not None and whole + 1 < len(rows):
            count, mean = group.mean
            earlier = rows[whole + 1]
            if row[count] and earlier[count]:
                out[mean] += shift.rest * (earlier[mean] - row[mean])


def alignment_shifts(latency: Mapping[str, float]) -> dict[str, float]:
    """Return the time by which each channel is delayed [s], so that all channels have the same
    latency.

    latency: latency by channel [s]. A channel without a latency has the latency of the
    accelerometer. The accelerometer is delayed by whole ticks, so that its ticks stay unchanged.
    The result is empty if no delay is needed.
    """
    accel = latency.get("accel", 0.0)
    most = max((late - accel for late in latency.values()), default=0.0)
    hold = math.ceil((most - MIN_SHIFT_S) * TICK_RATE) / TICK_RATE if most > MIN_SHIFT_S else 0.0
    shifts = {channel: hold - (latency.get(channel, accel) - accel) for channel in _GROUPS}
    shifts = {channel: max(shift, 0.0) for channel, shift in shifts.items()}
    return shifts if any(shift > MIN_SHIFT_S for shift in shifts.values()) else {}
