"""Prepare the ticks for the estimator with the model: align signals in time and remove the lean of
the body on its suspension.

If a body rolls more in left turns than in right turns, or squats more than it dives, its mean
attitude biases the mount estimate. The current mount is accurate enough to remove the lean. Before
there is a mount, ticks stay unchanged. This module does not remove the effect of the lever arm. The
estimator removes this effect with the rates before and after the tick, and the later rates are not
known here.
"""

from __future__ import annotations

from collections.abc import Sequence

from imucald.core.rotations import times, transposed_times
from imucald.model_compensation.filters import SuspensionFilter
from imucald.model_compensation.held_repeats import HeldRepeats
from imucald.model_compensation.lever_arm_and_suspension import less_suspension_rate, on_road
from imucald.model_compensation.time_alignment import TimeAlignment
from imucald.motion import ticks as tk
from imucald.motion.stuck import SAME
from imucald.motion.ticks import TICK_S
from imucald.mount.estimate import Correction

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
