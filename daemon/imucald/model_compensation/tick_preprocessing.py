"""Prepare the ticks for the estimator with the model: align signals in time and remove the lean of
the body on its suspension.

Each channel is delayed until the channel with the largest latency has arrived. Whole ticks of delay
are made by storing rows. The remaining part of a tick is subtracted from the age that a tick states
for its samples, or the mean is interpolated. A known delay is therefore not estimated again, and
does not disturb parts of the program that cannot handle delays. Only the estimator waits. Samples
are corrected when they arrive.

If a body rolls more in left turns than in right turns, or squats more than it dives, its mean
attitude biases the mount estimate. The current mount is accurate enough to remove the lean. Before
there is a mount, ticks stay unchanged. This module does not remove the effect of the lever arm. The
estimator removes this effect with the rates before and after the tick, and the later rates are not
known here.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from imucald.core.rotations import times, transposed_times
from imucald.core.samples import FLAGS
from imucald.model_compensation.filters import SuspensionFilter
from imucald.model_compensation.held_repeats import HeldRepeats
from imucald.model_compensation.lever_arm_and_suspension import less_suspension_rate, on_road
from imucald.motion import ticks as tk
from imucald.motion.column_ticks import TickAccumulator
from imucald.motion.stuck import SAME
from imucald.motion.ticks import TICK_RATE, TICK_S
from imucald.mount.estimate import Correction

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


_FORCES = slice(tk.ACCEL.x, tk.ACCEL.z + 1)
_RATES = slice(tk.GYRO.x, tk.GYRO.z + 1)
_SENSORS = ((tk.ACCEL.n, _FORCES), (tk.GYRO.n, _RATES))


class TickPreprocessing:
    """Receives rows of ticks and returns the rows for the estimator.

    time_alignment: alignment in time; None: all signals have the same age. suspension: attitude of
    the body, at ten ticks per second; None: a stiff suspension.
    """

    def __init__(
        self, time_alignment: TimeAlignment | None, suspension: SuspensionFilter | None
    ) -> None:
        self._time_alignment = time_alignment
        self._suspension = suspension
        self._taken: tuple[float, float] | None = None
        self._repeats = tuple(HeldRepeats(SAME) for _ in _SENSORS)

    def gap(self) -> None:
        """Restart after a jump of time: ticks before the jump are not joined with ticks after
        it."""
        if self._time_alignment is not None:
            self._time_alignment.gap()
        if self._suspension is not None:
            self._suspension.restart()
        self._taken = None
        for repeats in self._repeats:
            repeats.restart()

    def row(self, row: Sequence[float], correction: Correction | None) -> Sequence[float]:
        """Return the row of a tick for the estimator.

        correction: correction that is applied during the tick. The lean is computed from the
        corrected force. The samples are rotated by the lean with the rotation of the housing only,
        so that the sensors' own errors stay the same.
        """
        if self._time_alignment is not None:
            row = self._time_alignment.row(row)
        if self._suspension is None:
            return row
        return self._repeated(row, self._upright(self._suspension, row, correction))

    def _upright(
        self, suspension: SuspensionFilter, row: Sequence[float], correction: Correction | None
    ) -> Sequence[float]:
        """Return the row of a tick with the force and rate of a stiff suspension.

        The change of the lean since the last removal is subtracted from the rate. Force and rate
        therefore stay consistent over a gap in the force. In such a gap, the gyroscope still
        measures the motion of the leaning body.
        """
        if correction is None:
            suspension.restart()
            self._taken = None
            return row
        out = list(row)
        if row[tk.ACCEL.n]:
            ahead, left, _ = correction.applied("accel", row[_FORCES])
            lean = suspension.push(row[tk.T], ahead, left)
            force = times(correction.rotation, row[_FORCES])
            out[_FORCES] = transposed_times(correction.rotation, on_road(lean, *force))
        roll, pitch = suspension.attitude[:2]
        if row[tk.GYRO.n]:
            before = self._taken or (roll, pitch)
            change = (roll - before[0]) / TICK_S, (pitch - before[1]) / TICK_S
            lean = roll, pitch, *change
            rate = less_suspension_rate(lean, *times(correction.rotation, row[_RATES]))
            out[_RATES] = transposed_times(correction.rotation, on_road(lean, *rate))
        self._taken = (roll, pitch) if row[tk.GYRO.n] else None
        return out

    def _repeated(self, row: Sequence[float], upright: Sequence[float]) -> Sequence[float]:
        """Keep repeated samples equal, so that a stuck sensor is still recognised as stuck."""
        out = list(upright)
        for (count, axes), repeats in zip(_SENSORS, self._repeats, strict=True):
            if row[count]:
                x, y, z = upright[axes]
                known = repeats.known(row[axes])
                out[axes] = (repeats.result if known else repeats.keep(row[axes], (x, y, z))) or ()
        return out
