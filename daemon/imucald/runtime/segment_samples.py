"""Samples of a segment of recorded frames: uncorrected and corrected."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.core.rotations import times_level_columns
from imucald.inputs.column_samples import ColumnSamples, Routed
from imucald.mount.estimate import HOUSING
from imucald.runtime.output.output_frames import OutputFrames
from imucald.runtime.pipeline import TickCorrections
from imucald.runtime.timebase import TimeSegment

if TYPE_CHECKING:
    from imucald.model_compensation.preprocessing import PreprocessingChain


class CorrectedSamples(Struct, frozen=True, eq=False):
    """Samples of a sensor in vehicle axes, as they are sent, before they are rounded for the
    frames.

    t: (N,) stream time [s]. values: (N, 3) SI, NaN if there is no correction. row: (N,) rows of the
    segment's frames. quality: (N,) quality as in the output frames, 0 if the values are NaN.
    """

    t: NDArray[np.float64]
    values: NDArray[np.float64]
    row: NDArray[np.int64]
    quality: NDArray[np.uint8]


class SegmentSamples(Struct, frozen=True, eq=False):
    """The samples of a segment of a chunk of frames.

    stamps: (N,) recorded times of the segment's frames [s]; rows of samples are indices of these
    frames. as_sensed: for each channel, the uncorrected samples, SI (see `core.samples`), in sensor
    axes. rejected: for each channel, the rows whose sample was rejected (without rejections by a
    model file). corrected: function that returns the corrected samples of each channel; they are
    computed at the first call.
    """

    segment: TimeSegment
    stamps: NDArray[np.float64]
    as_sensed: Mapping[str, ColumnSamples]
    rejected: Mapping[str, NDArray[np.int64]]
    corrected: Callable[[], Mapping[str, CorrectedSamples]]


def corrected_samples(
    routed: Routed,
    corrections: TickCorrections,
    ticks: NDArray[np.int64],
    output: OutputFrames,
    preprocessing: PreprocessingChain | None,
) -> dict[str, CorrectedSamples]:
    """Return corrected samples by channel; NaN if there is no correction.

    ticks: (N,) ticks of the segment's frames. preprocessing: removes the effects that a model file
    states.
    """
    found = {c: routed.samples[c] for c in output.triads if c in routed.samples}
    tick = {c: ticks[series.row] - corrections.first for c, series in found.items()}
    turned = {
        channel: corrections.turned(channel, tick[channel], series.values)
        for channel, series in found.items()
    }
    if preprocessing is not None:
        turned = preprocessing.corrected_columns(found, turned)
    for channel in output.planar & found.keys():
        rows = corrections.rows_in(HOUSING, tick[channel])
        turned[channel] = times_level_columns(rows, found[channel].values)
    corrected: dict[str, CorrectedSamples] = {}
    for channel, series in found.items():
        values, quality = turned[channel], corrections.quality[tick[channel]]
        unfit = corrections.unfit.get(output.sensor_of[channel])
        if unfit is not None:
            faulty = unfit[tick[channel]]
            values = np.where(faulty[:, None], np.nan, values)
            quality = np.where(faulty, 0, quality).astype(np.uint8)
        corrected[channel] = CorrectedSamples(series.t, values, series.row, quality)
    return corrected
