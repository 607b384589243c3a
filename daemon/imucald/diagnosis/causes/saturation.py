"""Samples that stand at the end of a sensor's range.

It is seen in the samples themselves: `imucald.diagnosis.faults` looks for it.
"""

from __future__ import annotations

from imucald.diagnosis.cause import Cause


class Saturation(Cause):
    """Values beyond the rail are cut."""

    name = "saturation"
    seen_by = "brake and corner hard"
    sentence = "A sensor runs into the end of its range."
