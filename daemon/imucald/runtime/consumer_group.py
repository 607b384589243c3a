"""The consumers of one engine together: fed sample by sample, live and in replay.

They run next to the calibration, and must not end it. Where numbers of a bus make a calculation of
one fail, the failure is counted, and that consumer begins anew: it sends *not available* until it
knows something again. A mistake of the program (any other exception) is none of these.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from traceback import extract_tb
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucald.core.errors import ImucaldError
from imucald.inputs.column_samples import Routed
from imucald.inputs.router import Sample
from imucald.mount.estimate import Correction
from imucald.runtime.consumer import Consumer, events_of, hand_on, in_order
from imucald.runtime.output.output_columns import OutPart, frames_part
from imucald.runtime.output.output_message import OutFrame
from imucald.runtime.pipeline import Snapshot, TickCorrections

FAILURES = (ImucaldError, ArithmeticError, ValueError)
"""What numbers can do to a calculation: refused, divided by zero, too large, outside a domain
(numpy's singular matrix is a ValueError)."""


class ConsumerGroup:
    """Hands samples, snapshots and ends of ticks on to each of the consumers; false without any."""

    def __init__(self, consumers: Sequence[Consumer]) -> None:
        self.all = tuple(consumers)
        self.failures = Counter[str]()
        """How often a calculation of a consumer failed, by its name."""
        self.last_failures: dict[str, str] = {}
        """The newest of them in words."""
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
                self._hand_on(consumer, t, channel, values, correction, unfit)

    def _hand_on(
        self,
        consumer: Consumer,
        t: float,
        channel: str,
        values: Sequence[float],
        correction: Correction | None,
        unfit: Collection[str],
    ) -> None:
        try:
            hand_on(consumer, t, channel, values, correction, unfit)
        except FAILURES as error:
            self._failed(consumer, error)

    def _tick(self, consumer: Consumer, k: int) -> list[OutFrame]:
        try:
            return consumer.tick(k)
        except FAILURES as error:
            self._failed(consumer, error)
            return consumer.tick(k)  # that nothing is available

    def _failed(self, consumer: Consumer, error: Exception) -> None:
        place = extract_tb(error.__traceback__)[-1]
        file = place.filename.replace("\\", "/").rpartition("/")[2]
        text = f"{type(error).__name__}: {error} ({file}, line {place.lineno})"
        self.failures[consumer.name] += 1
        self.last_failures[consumer.name] = text
        consumer.begin_anew()

    def summaries(self) -> dict[str, dict[str, Any]]:
        """What each came to, by its key, and how often a calculation failed."""
        return {
            name: {**content, "failures": self.failures[name]}
            for name, content in (consumer.summary() for consumer in self.all)
        }

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
                    out += self._tick(consumer, k)
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
        in_force = corrections.corrections
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
                self._hand_on(consumer, t, channel, values, in_force[tick - first], unfit)
        while k < int(ticks[-1]):
            yield from close(k)
            k += 1
