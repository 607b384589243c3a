"""The estimator's ticks with what the model knows: delays evened out, the body's leaning taken out.

A body that rolls more in left turns than in right ones, or squats more than it dives, turns the
mean of what the mount is found from. The mount in force is good enough to place its lean; before
there is one, ticks stay as they are. The lever arm is left in: the estimator takes it off by
itself, with rates from before and after, which here are still to come.
"""

from __future__ import annotations

from collections.abc import Sequence

from imucald.compensation.retiming import Retiming
from imucald.compensation.vehicle import VehicleStage
from imucald.motion import ticks as tk
from imucald.mount.estimate import Correction
from imucald.mount.stuck import SAME
from imucald.out_parts import rotated

_RATES = slice(tk.GYRO_X, tk.GYRO_Z + 1)
_TRIADS = (("accel", tk.ACCEL_N, tk.ACCEL_X), ("gyro", tk.GYRO_N, tk.GYRO_X))


class EvidenceStage:
    """Takes rows of ticks, gives those that the estimator is to see.

    leaning: the same filter as for samples, at ten a second; None: the body does not lean.
    """

    def __init__(self, retiming: Retiming | None, leaning: VehicleStage | None) -> None:
        self._retiming = retiming
        self._leaning = leaning
        self._rate: Sequence[float] | None = None
        self._result: Sequence[float] = ()

    def gap(self) -> None:
        """Time jumped: nothing before is joined with what follows."""
        if self._retiming is not None:
            self._retiming.gap()
        if self._leaning is not None:
            self._leaning.gap()
        self._rate = None

    def row(self, row: Sequence[float], correction: Correction | None) -> Sequence[float]:
        """Return the row of a tick as the estimator is to see it.

        correction: the mount in force during the tick.
        """
        if self._retiming is not None:
            row = self._retiming.row(row)
        if self._leaning is None:
            return row
        return self._repeated(row, _upright(self._leaning, row, correction))

    def _repeated(self, row: Sequence[float], upright: Sequence[float]) -> Sequence[float]:
        """A gyroscope that repeats itself goes on doing so: a stuck one must be seen to be."""
        if not row[tk.GYRO_N]:
            return upright
        rate = row[_RATES]
        if self._rate is None or any(
            abs(a - b) > SAME for a, b in zip(rate, self._rate, strict=True)
        ):
            self._rate, self._result = rate, upright[_RATES]
            return upright
        out = list(upright)
        out[_RATES] = self._result
        return out


def _upright(
    leaning: VehicleStage, row: Sequence[float], correction: Correction | None
) -> Sequence[float]:
    """Force and rate of a tick as if the body were stiff."""
    sensors = [(channel, first) for channel, count, first in _TRIADS if row[count]]
    turned = {c: rotated(correction, row[first : first + 3]) for c, first in sensors}
    found = leaning.frame(row[tk.T], turned)
    if correction is None:
        return row
    a, b, c, d, e, f, g, h, i = correction
    out = list(row)
    for channel, first in sensors:
        back = rotated((a, d, g, b, e, h, c, f, i), found[channel] or (0.0, 0.0, 0.0))
        out[first : first + 3] = back or ()
    return out
