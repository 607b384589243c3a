"""Frames that are missing.

It is seen in the samples themselves: `imucald.diagnosis.faults` looks for it.
"""

from __future__ import annotations

from imucald.diagnosis.cause import Cause


class Dropouts(Cause):
    """Bursts of frames are lost."""

    name = "dropouts"
    seen_by = "record for longer"
    sentence = "Frames of a signal are missing."
