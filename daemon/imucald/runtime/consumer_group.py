"""The consumers of one engine together: fed sample by sample, live and in replay."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from imucald.inputs.column_samples import Routed
from imucald.inputs.router import Sample
from imucald.mount.estimate import Correction
from imucald.runtime.consumer import Consumer, events_of, hand_on, in_order
from imucald.runtime.output.output_columns import OutPart, frames_part
from imucald.runtime.output.output_message import OutFrame
from imucald.runtime.pipeline import Snapshot, TickCorrections


class ConsumerGroup:
    """Hands samples, snapshots and ends of ticks on to each of the consumers; false without any."""

    def __init__(self, consumers: Sequence[Consumer]) -> None:
        self.all = tuple(consumers)
        self._channels = frozenset(c for one in self.all for c in one.channels)

    def __bool__(self) -> bool:
        return bool(self.all)

    def feed(
        self,
        t: float,
        samples: Sequence[Sample],
        correction: Correction | None,
        unfit: Collection[str],
    ) -> None:
        """Hand on the samples of one frame at stream time t [s]; unfit: see `hand_on`."""
        for channel, values in in_order(samples):
            for consumer in self.all:
                hand_on(consumer, t, channel, values, correction, unfit)

    def end_ticks(
        self, first: int, stop: int, snapshots: Sequence[Snapshot], is_late: bool = False
    ) -> list[OutFrame]:
        """Ticks `first` to `stop` - 1 have ended; return the frames that are due.

        is_late: too long ago for anything to be sent of them.
        """
        taken = {snapshot.k: snapshot.estimate for snapshot in snapshots}
        out: list[OutFrame] = []
        for k in range(first, stop):
            for consumer in self.all:
                if k in taken:
                    consumer.mounted(taken[k])
                if not is_late:
                    out += consumer.tick(k)
        return out

    def gap(self) -> None:
        """Time jumped."""
        for consumer in self.all:
            consumer.gap()

    def columns(
        self,
        routed: Routed,
        corrections: TickCorrections,
        snapshots: Sequence[Snapshot],
        ticks: NDArray[np.int64],
        base: int,
    ) -> Iterator[OutPart]:
        """Take a segment one by one; the frames stand as status frames do.

        ticks: (N,) of its frames; base: its first row.
        """
        rotations = corrections.corrections
        k = first = corrections.first
        due = {snapshot.k: snapshot for snapshot in snapshots}

        def close(k: int) -> Iterator[OutPart]:
            out = self.end_ticks(k, k + 1, [due[k]] if k in due else ())
            if out:
                yield frames_part(out, base + int(np.searchsorted(ticks, k, side="right")))

        unfit: list[str] = []
        unfit_tick = first - 1  # the tick that `unfit` is of: each has some ten samples
        for row, t, channel, values in events_of(routed.samples, self._channels):
            tick = int(ticks[row])
            while k < tick:
                yield from close(k)
                k += 1
            if tick != unfit_tick:
                unfit = [c for c, flags in corrections.unfit.items() if flags[tick - first]]
                unfit_tick = tick
            for consumer in self.all:
                hand_on(consumer, t, channel, values, rotations[tick - first], unfit)
        while k < int(ticks[-1]):
            yield from close(k)
            k += 1
