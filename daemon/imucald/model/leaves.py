"""What the drives that a model file was made of leave of an equation (section of the file)."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from imucald.model.section import NonNegative, Positive, Section

BANDS_HZ = (0.0, 0.1, 0.2, 0.4, 1.0, 2.5, 5.0)
"""Edges of the bands."""
Bands = tuple[NonNegative, NonNegative, NonNegative, NonNegative, NonNegative, NonNegative]


class Leaves(Section, frozen=True):
    """Of the segments of those drives, in motion; bands as in `BANDS_HZ`."""

    segments: Annotated[int, Meta(ge=1)]
    segment_s: Positive
    speeds_mps: tuple[NonNegative, NonNegative]
    """Mean speed of a segment: of 5 % of them it is below, of 5 % above."""
    rms: Bands
    """By band: what half of the segments leave at most, in the equation's SI unit."""
    spread: Bands
    """By band: deviation of the logarithm of that between segments."""
