"""Frames to send while they are still columns: turned samples, and parts put in order."""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.can.columns import FrameColumns
from imucald.inputs.router import Routed


class OutPart(Struct, frozen=True, eq=False):
    """Frames to send with the input row they belong to and their rank within it.

    Status frames have rank 0: they stand before the corrected frames of the row that brought them
    about.
    """

    row: NDArray[np.int64]
    rank: NDArray[np.int64]
    can_id: NDArray[np.uint32]
    data: NDArray[np.uint8]


def corrected_count(routed: Routed, channel: str) -> int:
    """Corrected frames that a channel comes to, without those that say *not available*."""
    series = routed.samples.get(channel)
    return 0 if series is None else len(series.row)


def merged(parts: list[OutPart], frames: FrameColumns) -> FrameColumns:
    """All parts in the order of rows, then ranks; each frame has its row's time of `frames`."""
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
