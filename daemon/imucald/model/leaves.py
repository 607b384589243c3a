"""Residuals of an equation in the drives that a model file was made from (section of the file).

Three more kinds of entries have the same form, so that an older version can read the file and
ignore them: changes of signals from sample to sample, statistics of successive samples, and the
levels of the values.
"""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from imucald.model.section import NonNegative, Positive, Section

BANDS_HZ = (0.0, 0.1, 0.2, 0.4, 1.0, 2.5, 5.0)
"""Edges of the bands."""
LAGS = (1, 2, 4, 8, 16, 32)
"""Numbers of samples over which changes of a signal are taken, in place of the bands."""
GAP_QUANTILES = (0.1, 0.25, 0.5, 0.75, 0.9, 1.0)
"""Quantiles of the gaps between occurring levels. The first is one step, since codes may be
missing."""
Bands = tuple[NonNegative, NonNegative, NonNegative, NonNegative, NonNegative, NonNegative]


class Leaves(Section, frozen=True):
    """Numbers of the segments of those drives, in motion; bands as in `BANDS_HZ`.

    `changes of AXIS at RATE Hz`: the bands are replaced by the lags in `LAGS`, and the rms by the
    ratio to the other axes. `samples of NUMBER at RATE Hz`: exponentials of six numbers without a
    unit (see `diagnosis.direct.next_samples`). `levels of SIGNAL`: `segments` gaps between levels
    in a drive of `segment_s`; `rms` has their quantiles (`GAP_QUANTILES`), each known within
    `spread`; `speeds_mps` has the least value above 0 and the largest value, in the signal's unit.
    """

    segments: Annotated[int, Meta(ge=1)]
    segment_s: Positive
    speeds_mps: tuple[NonNegative, NonNegative]
    """Range of the segments' mean speeds: 5 % of them are below it and 5 % above."""
    rms: Bands
    """Median rms residual of the segments by band, in the equation's SI unit."""
    spread: Bands
    """Standard deviation of the logarithm of the rms between segments, by band."""
