"""What runs next to the mount calibration on the same samples.

A consumer takes samples one by one, in the same order live as in replay, and gives frames at ends
of ticks. The engine knows consumers only by the protocol here; `consumers` has those there are.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

from imucald.inputs.column_samples import ColumnSamples
from imucald.inputs.router import Sample
from imucald.mount.estimate import Correction, MountEstimate
from imucald.runtime.output.output_message import OutFrame

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


def hand_on(
    consumer: Consumer,
    t: float,
    channel: str,
    values: Sequence[float],
    correction: Correction | None,
    unfit: Collection[str],
) -> None:
    """Hand a sample on to a consumer that wants it; unfit: channels of faulty sensors now.

    Of a faulty sensor nothing is handed on. Where it is one that the consumer carries on from, it
    begins anew when that is sound again, and has nothing to say until then.
    """
    if channel not in consumer.channels:
        return
    if not unfit:
        consumer.sample(t, channel, values, correction)
    elif not INERTIAL.isdisjoint(consumer.channels.intersection(unfit)):
        consumer.gap()
    elif channel not in unfit:
        consumer.sample(t, channel, values, correction)


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
