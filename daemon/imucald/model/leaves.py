"""Section of the model file with the residuals of the equations in the drives from which the file
was made.

Three further kinds of entries have the same form, so that an older version can read the file and
ignore these entries. These entries are changes of signals from sample to sample, statistics of
successive samples, and the levels of the values.
"""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from imucald.model.section import NonNegative, Positive, Section

BANDS_HZ = (0.0, 0.1, 0.2, 0.4, 1.0, 2.5, 5.0)
"""Edges of the frequency bands [Hz]."""
LAGS = (1, 2, 4, 8, 16, 32)
"""Numbers of samples over which changes of a signal are taken. These numbers replace the frequency
bands."""
GAP_QUANTILES = (0.1, 0.25, 0.5, 0.75, 0.9, 1.0)
"""Quantiles of the gaps between neighbouring levels.

The first quantile, which nine tenths of the gaps reach or exceed, is taken as one step. Other gaps
may be larger, because codes may be missing."""
Bands = tuple[NonNegative, NonNegative, NonNegative, NonNegative, NonNegative, NonNegative]


class Leaves(Section, frozen=True):
    """Numbers of the segments of these drives, in motion. The bands are `BANDS_HZ`.

    `changes of AXIS at RATE Hz`: the lags `LAGS` replace the bands, and the ratio to the other axes
    replaces the rms. `samples of NUMBER at RATE Hz`: exponentials of six numbers without a unit
    (see `diagnosis.direct.successive`). `levels of SIGNAL`: `segments` is the number of gaps
    between levels in a drive of `segment_s`. `rms` has the quantiles of the gaps (`GAP_QUANTILES`),
    each known within `spread`. `speeds_mps` has the smallest value above 0 and the largest value,
    in the unit of the signal.
    """

    segments: Annotated[int, Meta(ge=1)]
    segment_s: Positive
    speeds_mps: tuple[NonNegative, NonNegative]
    """Range of the segments' mean speeds: 5 % of the segments are slower and 5 % are faster."""
    rms: Bands
    """Median rms residual of the segments by band, in the equation's SI unit."""
    spread: Bands
    """Standard deviation of the logarithm of the rms between segments, by band."""
