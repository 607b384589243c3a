"""Make the samples of a chunk of frames, by channel: join several sources, and assemble three-axis
samples whose axes are in different frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from imucald.can.columns import FrameColumns, IdMatch
from imucald.core.samples import Series, width_of
from imucald.inputs.source_selector import SourceSelector, TapSamples, TriadAssembler, in_row_order
from imucald.inputs.taps import Tap

Rows = NDArray[np.int64]


class ColumnSamples(Series, frozen=True, eq=False):
    """Samples with their origin. row: (N,) int64, row of each sample's frame in the chunk."""

    row: Rows = field(default_factory=lambda: np.zeros(0, np.int64))


class Routed(Struct, frozen=True, eq=False):
    """The result of a chunk of frames.

    samples: by channel. rejected: by channel, the rows with a rejected sample, in order.
    rejected_values: by channel, the rows of samples that were rejected because of their value (not
    because the whole frame was rejected).
    events: (M,) stream times of all counted rejections [s], in order.
    """

    samples: dict[str, ColumnSamples]
    rejected: dict[str, Rows]
    rejected_values: dict[str, Rows]
    events: NDArray[np.float64]


def joined(found: list[TapSamples], selector: SourceSelector | None) -> ColumnSamples:
    """Join the samples of all sources of a channel. The preferred source is selected. For parts of
    three-axis samples, use `assembled`."""
    whole = sorted(found, key=lambda part: part.tap.rank)
    if selector is not None:
        by_rank: dict[int, TapSamples] = {}
        for part in whole:
            known = by_rank.get(part.tap.rank)
            by_rank[part.tap.rank] = part if known is None else known.merged(part)
        whole = [
            part.take(selector.accept_columns(part.t, part.row, rank))
            for rank, part in sorted(by_rank.items())
        ]
    merged = whole[0]
    for part in whole[1:]:
        merged = merged.merged(part)
    return ColumnSamples(merged.t, merged.values, merged.row)


def assembled(
    channel: str,
    found: list[TapSamples],
    selector: SourceSelector | None,
    assemblers: Mapping[tuple[str, int], TriadAssembler],
    refused: list[tuple[Tap, Rows]],
    refused_values: list[tuple[Tap, Rows]],
) -> ColumnSamples:
    """Assemble the samples of a channel whose axes are in different frames. The steps are the same
    as for single frames, in row order.

    refused: list to which the rows of incomplete three-axis samples are added. refused_values: list
    to which the rows of three-axis samples with a rejected value are added.
    """
    t_out: list[float] = []
    rows_out: list[int] = []
    values_out: list[Sequence[float]] = []
    for row, tap, t, value, code in in_row_order(found):
        values: Sequence[float] | None = value
        if not tap.complete:
            values, bad = assemblers[channel, tap.rank].add_parts(
                t, tap.slots, None if code else value
            )
            if bad:
                to = refused_values if code else refused
                to.append((tap, np.array([row], dtype=np.int64)))
            if values is None:
                continue
        if selector is not None and not selector.accept_row(t, row, tap.rank):
            continue
        t_out.append(t)
        rows_out.append(row)
        values_out.append(values or ())
    width = width_of(channel)
    values_array = np.array(values_out).reshape(len(t_out), width)
    return ColumnSamples(
        np.array(t_out),
        values_array if width > 1 else values_array[:, 0],
        np.array(rows_out, dtype=np.int64),
    )


def rows_of(match: IdMatch, frames: FrameColumns) -> NDArray[np.int64]:
    """Return the rows of the frames that match."""
    mask = np.uint32(match.full_mask)
    hit = (frames.can_id & mask) == np.uint32(match.can_id & match.full_mask)
    if match.channel is not None:
        wanted = [i for i, name in enumerate(frames.channels) if name == match.channel]
        hit &= np.isin(frames.channel, wanted)
    return np.flatnonzero(hit)
