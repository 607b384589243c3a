"""Frames to send as columns: encode corrected samples, and merge all frames in the right order."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.can.columns import FrameColumns
from imucald.inputs.column_samples import Routed
from imucald.runtime.output.output_frames import OutFrame, OutputFrames
from imucald.runtime.segment_samples import CorrectedSamples


class OutPart(Struct, frozen=True, eq=False):
    """Frames to send. row: row of the input frame after which the frame is sent. rank: order within
    the row. Status frames have rank 0: they are sent before the corrected frames of the same row.
    """

    row: NDArray[np.int64]
    rank: NDArray[np.int64]
    can_id: NDArray[np.uint32]
    data: NDArray[np.uint8]


def corrected_count(routed: Routed, channel: str) -> int:
    """Return the number of frames with a corrected sample of a channel. Frames *not available* do
    not count.
    """
    series = routed.samples.get(channel)
    return 0 if series is None else len(series.row)


def frames_part(out: Sequence[OutFrame], row: int) -> OutPart:
    """Return the frames as a part of the output. The frames are sent before the frames of the
    samples of `row`, in the given order."""
    return OutPart(
        np.full(len(out), row),
        np.zeros(len(out), np.int64),  # one frame may close many ticks: keep their order
        np.array([can_id for can_id, _ in out], dtype=np.uint32),
        np.frombuffer(b"".join(data for _, data in out), np.uint8).reshape(len(out), -1),
    )


def corrected_parts(
    output: OutputFrames,
    corrected: Mapping[str, CorrectedSamples],
    lost: Mapping[str, NDArray[np.int64]],
    base: int,
) -> Iterator[OutPart]:
    """Yield the frames of a segment's corrected samples, and the frames *not available*, by
    channel.

    lost: for each channel, the rows of the frames *not available*. base: first row of the segment.
    """
    for order, channel in enumerate(output.triads):
        found = corrected.get(channel)
        bad = lost[channel]
        if found is None:
            if not len(bad):
                continue
            row, turned = np.zeros(0, np.int64), np.zeros((0, 3))
            quality = np.zeros(0, np.uint8)
        else:
            row, turned, quality = found.row, found.values, found.quality
        if len(bad):
            row = np.concatenate([row, bad])
            by_row = np.argsort(row, kind="stable")
            row = row[by_row]
            turned = np.concatenate([turned, np.full((len(bad), 3), np.nan)])[by_row]
            quality = np.concatenate([quality, np.zeros(len(bad), np.uint8)])[by_row]
        can_id, data = output.corrected_columns(channel, turned, quality)
        # Not-available frames of a row come after its corrected ones, as for single frames.
        missing = np.isin(row, bad)
        rank = np.where(missing, len(output.triads), 0) + order + 1
        yield OutPart(base + row, rank, np.full(len(row), can_id, np.uint32), data)


def merged(parts: list[OutPart], frames: FrameColumns) -> FrameColumns:
    """Merge all parts, sorted by row and then by rank. The time of each frame is the time of its
    row in `frames`.
    """
    if not parts:
        return frames.take(slice(0, 0))
    row = np.concatenate([p.row for p in parts])
    rank = np.concatenate([p.rank for p in parts])
    order = np.lexsort((rank, row))
    row = row[order]
    data = np.concatenate([p.data for p in parts])[order]
    return FrameColumns(
        t=frames.t[np.minimum(row, len(frames) - 1)],
        can_id=np.concatenate([p.can_id for p in parts])[order],
        length=np.full(len(row), data.shape[1], np.uint8),
        data=data,
        channel=np.zeros(len(row), np.uint8),
        channels=frames.channels[:1] or ("can0",),
    )
