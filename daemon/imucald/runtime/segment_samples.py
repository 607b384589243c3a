"""What a segment of recorded frames came to: samples as they came, and corrected."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.inputs.router import ColumnSamples
from imucald.runtime.timebase import TimeSegment


class CorrectedSamples(Struct, frozen=True, eq=False):
    """Samples of a sensor in vehicle axes, as they are sent, before they are rounded into frames.

    t: (N,) stream time [s]. values: (N, 3) SI, NaN where there is no correction. row: (N,) of the
    segment's frames. quality: (N,) as on the bus, 0 where values are NaN.
    """

    t: NDArray[np.float64]
    values: NDArray[np.float64]
    row: NDArray[np.int64]
    quality: NDArray[np.uint8]


class SegmentSamples(Struct, frozen=True, eq=False):
    """The samples of a segment of a chunk of frames.

    stamps: (N,) recorded times of the segment's frames [s]; rows of samples count in them.
    as_sensed: by channel, as the sensors gave them, SI (see `core.samples`), in sensor axes.
    corrected: gives them by channel of a corrected frame; they are made when it is first called.
    """

    segment: TimeSegment
    stamps: NDArray[np.float64]
    as_sensed: Mapping[str, ColumnSamples]
    corrected: Callable[[], Mapping[str, CorrectedSamples]]
