"""A signal that does not change although frames come.

It is seen in the samples themselves: `imucald.diagnosis.faults` looks for it.
"""

from __future__ import annotations

from imucald.diagnosis.cause import Cause


class StuckSignal(Cause):
    """The value is frozen for a while."""

    name = "stuck_signal"
    seen_by = "drive on with changing speed and steering"
    sentence = "A signal is stuck for a while."
