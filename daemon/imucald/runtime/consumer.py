"""Consumers: calculations that run along with the mount calibration on the same samples.

A consumer takes samples one by one, in the same order live and in replay, and returns frames at the
ends of ticks. The engine knows consumers only by this protocol; `consumers` has the existing ones.

`ConsumerGroup` holds the consumers of one engine, which are fed sample by sample, live and in
replay.

Consumers run along with the calibration and must not stop it. If numbers from the bus make a
calculation fail, the failure is counted and that consumer restarts. It sends *not available* until
it has a result again. Any other exception is a mistake of the program and is not caught.
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
"""Order in which samples of one frame are passed on."""
INERTIAL = frozenset(("accel", "gyro"))
"""Channels whose samples a consumer integrates, so that each result depends on all earlier
samples.
"""
_RANK = {channel: rank for rank, channel in enumerate(ORDER)}


class Consumer(Protocol):
    """Takes samples, returns frames. Pure: no I/O, no clock."""

    name: str
    """Key of its result."""

    @property
    def channels(self) -> frozenset[str]:
        """Channels that it needs (see `samples`)."""
        ...

    def sample(
        self, t: float, channel: str, values: Sequence[float], correction: Correction | None
    ) -> None:
        """Take a sample at stream time t [s], as the sensor gave it, and the correction in
        force.
        """
        ...

    def mounted(self, estimate: MountEstimate) -> None:
        """Take a snapshot of the mount.

        The call comes before the tick at whose end the snapshot was taken.
        """
        ...

    def tick(self, k: int) -> list[OutFrame]:
        """Note that tick k has ended; return the frames that are due."""
        ...

    def gap(self) -> None:
        """Note a jump of time: no value from before may be differenced with a later one."""
        ...

    def begin_anew(self) -> None:
        """Forget all results from samples, because a calculation failed; nothing is available
        then.
        """
        ...

    def summary(self) -> tuple[str, Mapping[str, Any]]:
        """Key and content of the result."""
        ...


@runtime_checkable
class ChecksSensors(Protocol):
    """A consumer with a sensor check that can be repeated and kept."""

    @property
    def checked(self) -> bool:
        """True if the check has been made, or is known from an earlier drive."""
        ...

    def check_sensors(self) -> None:
        """Repeat the check at the next rest that is long enough."""
        ...

    def saved_check(self) -> Mapping[str, Any] | None:
        """Return the result of the check for the saved state: sensor axes, SI; None before it."""
        ...

    def restore_check(self, saved: object) -> None:
        """Take a saved check if it is plausible; it is used once there is a mount."""
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
"""Exceptions that numbers can cause in a calculation: refused, divided by zero, too large, outside
a domain (numpy's singular matrix is a ValueError).
"""


class ConsumerGroup:
    """Passes samples, snapshots and ends of ticks to each consumer; false without any."""

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
        """Pass on the samples of one frame at stream time t [s]. unfit: see `_hand_on`."""
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

        unfit: channels of sensors that are faulty now. Samples of a faulty sensor are not passed
        on. If the consumer integrates that sensor's samples, it begins again when the sensor has no
        fault any more. Until then it has no result.
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
        """Note that ticks `first` to `stop` - 1 have ended; return the frames that are due.

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
        """Note a jump of time."""
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
        """Take a segment sample by sample; the frames are placed as status frames are.

        ticks: (N,) ticks of its frames; base: its first row.
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
