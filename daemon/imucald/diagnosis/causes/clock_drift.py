"""A unit's clock runs fast or slow.

It is seen in the samples themselves: `imucald.diagnosis.faults` looks for it.
"""

from __future__ import annotations

from imucald.diagnosis.cause import Cause


class ClockDrift(Cause):
    """The cycle is off its nominal rate, or stamps run off."""

    name = "clock_drift"
    seen_by = "record for longer"
    sentence = "A unit's clock is off."
