"""Consumers: calculations that use the same samples as the mount calibration and run in parallel
with it.

A consumer receives samples one by one, in the same order live and in replay. A consumer returns
frames at the ends of ticks. The engine knows only the protocol `Consumer`; the module `consumers`
contains the existing consumers. `ConsumerGroup` contains the consumers of one engine.

A consumer must not stop the calibration. If numbers from the bus cause an error in a calculation,
the error is counted and this consumer restarts. The consumer sends *not available* until it has a
result again. Any other exception is an error in the program and is not caught.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from traceback import extract_tb
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from imucald.core.errors import ImucaldError
from imucald.inputs.column_samples import ColumnSamples, Routed
from imucald.inputs.router import Sample
from imucald.mount.estimate import Correction, MountEstimate
from imucald.runtime.output.output_columns import OutPart, frames_part
from imucald.runtime.output.output_message import OutFrame
from imucald.runtime.pipeline import Snapshot, TickCorrections

ORDER = ("reverse", "speed", "heading", "gyro", "mag", "accel")
"""Order of channels in which the samples of one frame are passed to consumers."""
INERTIAL = frozenset(("accel", "gyro"))
"""Channels whose samples a consumer integrates. Each result therefore depends on all earlier
samples.
"""
_RANK = {channel: rank for rank, channel in enumerate(ORDER)}


class Consumer(Protocol):
    """Interface of a calculation that receives samples and returns frames. A consumer has no I/O
    and reads no clock."""

    name: str
    """Name of the consumer, and key of its result."""

    @property
    def channels(self) -> frozenset[str]:
        """Channels that the consumer needs (see `core.samples`)."""
        ...

    def sample(
        self, t: float, channel: str, values: Sequence[float], correction: Correction | None
    ) -> None:
        """Process a sample at stream time t [s]. values: uncorrected. correction: the present
        correction.
        """
        ...

    def mounted(self, estimate: MountEstimate) -> None:
        """Process a new mount estimate. The call comes before the call of `tick` for the tick at
        whose end the estimate was computed.
        """
        ...

    def tick(self, k: int) -> list[OutFrame]:
        """Process the end of tick k. Return the frames that are due."""
        ...

    def gap(self) -> None:
        """Process a jump of time: values from before the jump must not be compared with later
        values."""
        ...

    def begin_anew(self) -> None:
        """Forget all results, because a calculation failed. No result is available afterwards."""
        ...

    def summary(self) -> tuple[str, Mapping[str, Any]]:
        """Return key and content of the result."""
        ...


def in_order(samples: Sequence[Sample]) -> Sequence[Sample]:
    """Return the samples of one frame in the order in which consumers take them."""
    return samples if len(samples) < 2 else sorted(samples, key=lambda s: _RANK.get(s[0], 99))


def events_of(
    samples: Mapping[str, ColumnSamples], wanted: Collection[str]
) -> list[tuple[int, float, str, Sequence[float]]]:
    """Return (row in the chunk, time, channel, values) of the wanted channels' samples, by row.

    The samples of a row have the order of `in_order`.
    """
    found: list[tuple[int, int, float, str, Sequence[float]]] = []
    for channel, series in samples.items():
        if channel in wanted:
            values = series.values if series.values.ndim == 2 else series.values[:, None]
            rank = _RANK[channel]
            found += [
                (row, rank, t, channel, value)
                for row, t, value in zip(
                    series.row.tolist(), series.t.tolist(), values.tolist(), strict=True
                )
            ]
    found.sort(key=lambda event: event[:2])
    return [(row, t, channel, values) for row, _, t, channel, values in found]


FAILURES = (ImucaldError, ArithmeticError, ValueError)
"""Exceptions that numbers from the bus can cause in a calculation: refused value, division by zero,
overflow, value outside a domain (numpy's singular matrix is a ValueError).
"""


class ConsumerGroup:
    """Passes samples, mount estimates and ends of ticks to each consumer. A group without consumers
    is false."""

    def __init__(self, consumers: Sequence[Consumer]) -> None:
        self.all = tuple(consumers)
        self.failures = Counter[str]()
        """Number of failed calculations of each consumer, by its name."""
        self.last_failures: dict[str, str] = {}
        """Text of the newest failure of each consumer."""
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
        """Pass the samples of one frame at stream time t [s] to the consumers. unfit: see
        `_hand_on`."""
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
        """Pass a sample to a consumer that wants it.

        unfit: channels of sensors that are faulty now. Samples of a faulty sensor are not passed to
        the consumer. If the consumer integrates the samples of this sensor, the consumer restarts
        when the fault ends. Until then it has no result.
        """
        if channel not in consumer.channels:
            return
        try:
            if not unfit:
                consumer.sample(t, channel, values, correction)
            elif not INERTIAL.isdisjoint(consumer.channels.intersection(unfit)):
                consumer.gap()
            elif channel not in unfit:
                consumer.sample(t, channel, values, correction)
        except FAILURES as error:
            self._failed(consumer, error)

    def _tick(self, consumer: Consumer, k: int) -> list[OutFrame]:
        try:
            return consumer.tick(k)
        except FAILURES as error:
            self._failed(consumer, error)
            return consumer.tick(k)  # says that nothing is available

    def _failed(self, consumer: Consumer, error: Exception) -> None:
        place = extract_tb(error.__traceback__)[-1]
        file = place.filename.replace("\\", "/").rpartition("/")[2]
        text = f"{type(error).__name__}: {error} ({file}, line {place.lineno})"
        self.failures[consumer.name] += 1
        self.last_failures[consumer.name] = text
        consumer.begin_anew()

    def summaries(self) -> dict[str, dict[str, Any]]:
        """Return the result of each consumer by its key, and the numbers of failed calculations."""
        return {
            name: {**content, "failures": self.failures[name]}
            for name, content in (consumer.summary() for consumer in self.all)
        }

    def end_ticks(
        self, first: int, stop: int, snapshots: Sequence[Snapshot], is_late: bool = False
    ) -> list[OutFrame]:
        """Process the ends of the ticks `first` to `stop` - 1. Return the frames that are due.

        is_late: the ticks are too old for their frames to be sent.
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
        """Pass a jump of time to the consumers."""
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
        """Process the samples of a segment one by one. The returned frames have the same positions
        as status frames.

        ticks: (N,) ticks of the segment's frames; base: first row of the segment.
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
