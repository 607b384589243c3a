"""What runs next to the mount calibration on the same samples.

A consumer takes samples one by one, in the same order live as in replay, and gives frames at ends
of ticks. The engine knows consumers only by the protocol here; `consumers` has those there are.

The consumers of one engine together: fed sample by sample, live and in replay.

They run next to the calibration, and must not end it. Where numbers of a bus make a calculation of
one fail, the failure is counted, and that consumer begins anew: it sends *not available* until it
knows something again. A mistake of the program (any other exception) is none of these.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from traceback import extract_tb
from typing import Any, Protocol, runtime_checkable

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
"""Samples of one frame are handed on in this order."""
INERTIAL = frozenset(("accel", "gyro"))
"""What a consumer carries on from one sample of these rests on all before."""
_RANK = {channel: rank for rank, channel in enumerate(ORDER)}


class Consumer(Protocol):
    """Takes samples, gives frames. Pure: no I/O, no clock."""

    name: str
    """Key of its result."""

    @property
    def channels(self) -> frozenset[str]:
        """The channels it wants (see `samples`)."""
        ...

    def sample(
        self, t: float, channel: str, values: Sequence[float], correction: Correction | None
    ) -> None:
        """Take a sample at stream time t [s], as the sensor gave it, and what is in force."""
        ...

    def mounted(self, estimate: MountEstimate) -> None:
        """Take a snapshot of the mount, before the tick that it was taken at the end of."""
        ...

    def tick(self, k: int) -> list[OutFrame]:
        """Tick k has ended: return the frames that are due."""
        ...

    def gap(self) -> None:
        """Time jumped: nothing before this may be differenced with what follows."""
        ...

    def begin_anew(self) -> None:
        """A calculation failed: forget all that came of samples; nothing is available then."""
        ...

    def summary(self) -> tuple[str, Mapping[str, Any]]:
        """Key and content of the result."""
        ...


@runtime_checkable
class ChecksSensors(Protocol):
    """A consumer with a sensor check that can be repeated and kept."""

    @property
    def checked(self) -> bool:
        """Whether it has been made, or is known from an earlier drive."""
        ...

    def check_sensors(self) -> None:
        """Repeat it at the next rest that is long enough."""
        ...

    def saved_check(self) -> Mapping[str, Any] | None:
        """What it found, as it is saved: sensor axes, SI; None before it."""
        ...

    def restore_check(self, saved: object) -> None:
        """Take what was saved, where it can be believed; it serves from the mount on."""
        ...


def in_order(samples: Sequence[Sample]) -> Sequence[Sample]:
    """Samples of one frame in the order consumers take them."""
    return samples if len(samples) < 2 else sorted(samples, key=lambda s: _RANK.get(s[0], 99))


def events_of(
    samples: Mapping[str, ColumnSamples], wanted: Collection[str]
) -> list[tuple[int, float, str, Sequence[float]]]:
    """Row, time, channel and values of the wanted channels' samples, in the order of `in_order`."""
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
        """Hand on the samples of one frame at stream time t [s]; unfit: see `_hand_on`."""
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
        """Hand a sample on to a consumer that wants it; unfit: channels of faulty sensors now.

        Of a faulty sensor nothing is handed on. Where it is one that the consumer carries on from,
        it begins again when that is sound again, and has nothing to say until then.
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
