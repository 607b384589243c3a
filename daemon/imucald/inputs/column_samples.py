"""Make the samples of a chunk of frames, by channel: select the preferred active source, join
several sources, and assemble three-axis samples whose axes are in different frames."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from imucald.can.columns import FrameColumns, IdMatch
from imucald.core.samples import Series, width_of
from imucald.inputs.taps import Tap

Times = NDArray[np.float64]
Rows = NDArray[np.int64]

SOURCE_HOLD = 1.5
"""If all preferred sources have been silent for this time, the next source is selected [s]. The
time is longer than the cycle of any speed signal and shorter than a driving manoeuvre."""


class SourceSelector:
    """Selects among `n` sources by preference (rank 0 first). Only good samples count as activity.

    Use `accept` for single samples. In a chunk of columns, samples are ordered by row, and by rank
    within a row. First call `begin_chunk`. Then call `accept_columns` for each rank, preferred
    ranks first, or `accept_row` for all samples in that order.
    """

    def __init__(self, n: int) -> None:
        self._last = [-math.inf] * n
        self._before = list(self._last)
        self._chunk: list[list[tuple[Times, Rows]]] = [[] for _ in range(n)]

    def accept(self, t: float, rank: int) -> bool:
        """Register a sample at t [s]. Return whether its source is selected."""
        self._last[rank] = t
        return self.selects(t, rank)

    def selects(self, t: float, rank: int) -> bool:
        """True if this source would be selected at t [s]."""
        return all(t - self._last[better] > SOURCE_HOLD for better in range(rank))

    def begin_chunk(self) -> None:
        """Begin a chunk of columns. Its rows are counted from 0."""
        self._before = list(self._last)
        self._chunk = [[] for _ in self._last]

    def accept_row(self, t: float, row: int, rank: int) -> bool:
        """Do the work of `accept` within a chunk."""
        self._chunk[rank].append((np.array([t]), np.array([row], np.int64)))
        return self.accept(t, rank)

    def accept_columns(self, t: Times, row: Rows, rank: int) -> NDArray[np.bool_]:
        """Do the work of `accept` for all samples (N,) of a source in the chunk, in order."""
        if len(t):
            self._chunk[rank].append((t, row))
            self._last[rank] = float(t[-1])
        return self.selects_columns(t, row, rank)

    def selects_columns(self, t: Times, row: Rows, rank: int) -> NDArray[np.bool_]:
        """Do the work of `selects` for times (N,) and rows, after all samples of the chunk were
        registered."""
        selected = np.ones(len(t), dtype=bool)
        for better in range(rank):
            selected &= t - self._last_at(better, row) > SOURCE_HOLD
        return selected

    def _last_at(self, rank: int, row: Rows) -> Times:
        found = self._chunk[rank]
        if not found:
            return np.full(len(row), self._before[rank])
        if len(found) > 1:
            times, rows = (np.concatenate(column) for column in zip(*found, strict=True))
            self._chunk[rank] = found = [(times, rows)]
        times, rows = found[0]
        index = np.searchsorted(rows, row, side="right")
        last: Times = np.concatenate([[self._before[rank]], times])[index]
        return last


MAX_SKEW = 0.1
"""Largest time difference between the values of a three-axis sample that are from different frames
[s]: one tick."""


class TapSamples(Struct, frozen=True, eq=False):
    """The samples of one tap in a chunk: times, rows, values (N, k) or (N,), and codes
    (`conversion.REASONS`)."""

    tap: Tap
    t: NDArray[np.float64]
    row: NDArray[np.int64]
    values: NDArray[np.float64]
    codes: NDArray[np.int8]

    def take(self, keep: NDArray[np.bool_] | NDArray[np.intp]) -> TapSamples:
        """Return the selected rows."""
        return TapSamples(
            self.tap, self.t[keep], self.row[keep], self.values[keep], self.codes[keep]
        )

    def merged(self, other: TapSamples) -> TapSamples:
        """Return the samples of both taps in the order of rows. In the same row, the sample of
        `self` is first."""
        row = np.concatenate([self.row, other.row])
        order = np.argsort(row, kind="stable")
        return TapSamples(
            self.tap,
            np.concatenate([self.t, other.t])[order],
            row[order],
            np.concatenate([self.values, other.values])[order],
            np.concatenate([self.codes, other.codes])[order],
        )


class TriadAssembler:
    """Assembles one sample (three axes, or four wheel speeds) from values of several frames.

    If a value arrives again before the sample is complete, a new sample begins, because another
    value was lost or has a lower rate. Therefore no value in a sample is older than one cycle of
    the other values.
    """

    def __init__(self, width: int) -> None:
        self._values: list[float | None] = [None] * width
        self._times = [-math.inf] * width

    def add_parts(
        self, t: float, slots: Sequence[int], values: Sequence[float] | None
    ) -> tuple[Sequence[float] | None, bool]:
        """Add some values of a sample. Return the complete sample or None, and whether a rejected
        value made a sample invalid."""
        if values is None:
            self._values = [None] * len(self._values)
            return None, True
        if any(self._values[slot] is not None for slot in slots):
            self._values = [None] * len(self._values)
        for slot, value in zip(slots, values, strict=True):
            self._values[slot] = value
            self._times[slot] = t
        for slot, time in enumerate(self._times):
            if t - time > MAX_SKEW:
                self._values[slot] = None
        whole = [v for v in self._values if v is not None]
        if len(whole) < len(self._values):
            return None, False
        self._values = [None] * len(self._values)
        return whole, False


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
    events: list[tuple[int, Tap, float, Sequence[float], int]] = []
    for part in sorted(found, key=lambda part: part.tap.rank):
        table = part.values.reshape(len(part.t), -1).tolist() if len(part.t) else []
        columns = part.row.tolist(), part.t.tolist(), table, part.codes.tolist()
        events += [(row, part.tap, t, v, code) for row, t, v, code in zip(*columns, strict=True)]
    events.sort(key=lambda event: event[0])
    for row, tap, t, value, code in events:
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
