"""Prepare the estimator's ticks with the model: align signals in time and remove the suspension's
lean.

If a body rolls more in left turns than in right ones, or squats more than it dives, its mean
attitude biases the mount estimate. The current mount is accurate enough to remove the lean; before
there is one, ticks stay unchanged. The lever arm is not removed here. The estimator removes it with
the rates before and after the tick; the later rates are not known here yet.
"""

from __future__ import annotations

from collections.abc import Sequence

from imucald.core.rotations import times, transposed_times
from imucald.model_compensation.held_repeats import HeldRepeats
from imucald.model_compensation.lever_arm_and_suspension import less_suspension_rate, on_road
from imucald.model_compensation.suspension import SuspensionFilter
from imucald.model_compensation.time_alignment import TimeAlignment
from imucald.motion import ticks as tk
from imucald.motion.stuck import SAME
from imucald.motion.ticks import TICK_S
from imucald.mount.estimate import Correction

_FORCES = slice(tk.ACCEL.x, tk.ACCEL.z + 1)
_RATES = slice(tk.GYRO.x, tk.GYRO.z + 1)
_SENSORS = ((tk.ACCEL.n, _FORCES), (tk.GYRO.n, _RATES))


class TickPreprocessing:
    """Takes rows of ticks and returns the rows for the estimator.

    suspension: of the body, at ten ticks per second; None: stiff.
    """

    def __init__(
        self, time_alignment: TimeAlignment | None, suspension: SuspensionFilter | None
    ) -> None:
        self._time_alignment = time_alignment
        self._suspension = suspension
        self._taken: tuple[float, float] | None = None
        self._repeats = tuple(HeldRepeats(SAME) for _ in _SENSORS)

    def gap(self) -> None:
        """Restart after a time jump: earlier and later ticks are not joined."""
        if self._time_alignment is not None:
            self._time_alignment.gap()
        if self._suspension is not None:
            self._suspension.restart()
        self._taken = None
        for repeats in self._repeats:
            repeats.restart()

    def row(self, row: Sequence[float], correction: Correction | None) -> Sequence[float]:
        """Return the row of a tick for the estimator.

        correction: the correction that is applied during the tick. The lean comes from the
        corrected force. The lean rotates the samples in the axes of the housing, so that their own
        errors stay the same.
        """
        if self._time_alignment is not None:
            row = self._time_alignment.row(row)
        if self._suspension is None:
            return row
        return self._repeated(row, self._upright(self._suspension, row, correction))

    def _upright(
        self, suspension: SuspensionFilter, row: Sequence[float], correction: Correction | None
    ) -> Sequence[float]:
        """Return force and rate of a tick as with a stiff suspension.

        The change of the lean since its last removal is subtracted from the rate. Force and rate
        therefore stay consistent over a gap in the force, in which the gyroscope measures the
        leaning body.
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
        """Keep repeated samples equal, so that a stuck sensor is still recognised."""
        out = list(upright)
        for (count, axes), repeats in zip(_SENSORS, self._repeats, strict=True):
            if row[count]:
                x, y, z = upright[axes]
                known = repeats.known(row[axes])
                out[axes] = (repeats.result if known else repeats.keep(row[axes], (x, y, z))) or ()
        return out
