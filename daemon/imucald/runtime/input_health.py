"""The content of the health frame: missing inputs and rejected frames."""

from __future__ import annotations

import bisect
from collections import deque
from collections.abc import Collection, Iterable, Mapping

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.inputs.column_samples import Routed
from imucald.motion.signal_health import Faults
from imucald.motion.ticks import tick_index
from imucald.runtime.output.output_frames import Health

MISSING_TICKS = 10
"""Number of ticks without a sample after which an input counts as missing: one second."""
_SENSORS = {"accel": "accelerometer_missing", "gyro": "gyroscope_missing", "speed": "speed_missing"}


class LinkHealth(Struct, frozen=True):
    """The part of the health that the bus link reports. All values are zero in replay."""

    lost: int = 0
    frames_lost: bool = False
    id_conflict: bool = False
    send_failed: bool = False


class InputWatch:
    """Stores the ticks of the last samples and of the rejections of one engine.

    channels: the configured channels. last: for each channel, the tick of the last sample.
    rejected: number of rejected frames and samples so far.
    """

    def __init__(self, channels: Iterable[str]) -> None:
        there = frozenset(channels)
        self.last = {c: 0 for c in _SENSORS if c in there}
        self.rejected = 0
        self._rejections: deque[int] = deque()  # ticks of the last second's rejections

    def go_on_from(self, former: InputWatch, same: Collection[str], k: int) -> None:
        """Continue from another watch at tick k. same: channels from the same sources.

        For the other channels, the time without a sample starts at tick k.
        """
        for channel in self.last:
            is_known = channel in same and channel in former.last
            self.last[channel] = former.last[channel] if is_known else k
        self.rejected, self._rejections = former.rejected, former._rejections

    def count_rejections(self, k: int, total: int) -> None:
        """Update the total number of rejections in tick k."""
        if total > self.rejected:
            self._rejections.append(k)
            self.rejected = total

    def take_columns(
        self, routed: Routed, events: NDArray[np.float64], last: int, total: int
    ) -> None:
        """Update with a chunk of columns. routed: samples of the chunk. events: (M,) ticks of its
        rejections. last: last tick of the chunk. total: number of rejections so far.
        """
        self.rejected = total
        recent = sorted(set(events[events > last - 2 * MISSING_TICKS].tolist()))
        self._rejections.extend(map(int, recent))
        for channel in self.last:
            if channel in routed.samples:
                self.last[channel] = tick_index(float(routed.samples[channel].t[-1]))

    def is_recent(self, k: int) -> bool:
        """Return whether any input was rejected in the second before the end of tick k."""
        while self._rejections and self._rejections[0] <= k - MISSING_TICKS:
            self._rejections.popleft()
        return bool(self._rejections) and self._rejections[0] <= k

    def last_until(self, k: int, routed: Routed | None) -> dict[str, int]:
        """Return the value of `last` at the end of tick k, including the samples of a chunk that is
        still being processed."""
        return {channel: self._last_sample(channel, k, routed) for channel in self.last}

    def _last_sample(self, channel: str, k: int, routed: Routed | None) -> int:
        series = routed.samples.get(channel) if routed is not None else None
        if series is None:
            return self.last[channel]
        n = bisect.bisect_right(series.t, k, key=tick_index)
        return tick_index(float(series.t[n - 1])) if n else self.last[channel]

    def health(self, k: int, link: LinkHealth, faults: Mapping[str, Faults]) -> Health:
        """Return the content of a health frame at the end of tick k."""
        return health_at(k, self.last, self.is_recent(k), self.rejected, link, faults)

    def all_missing(self, link: LinkHealth, is_rejecting: bool = False) -> Health:
        """Return the content of a health frame while nothing is received."""
        never = dict.fromkeys(self.last, -MISSING_TICKS)
        return health_at(0, never, is_rejecting, self.rejected, link, {})


def health_at(
    k: int,
    last: Mapping[str, int],
    is_rejecting: bool,
    rejected: int,
    link: LinkHealth,
    faults: Mapping[str, Faults],
) -> Health:
    """Return the content of a health frame at the end of tick k.

    last: for each channel, the tick of the last sample.
    """
    return Health(
        **{_SENSORS[c]: k - tick >= MISSING_TICKS for c, tick in last.items()},
        accelerometer_faulty="accel" in faults,
        gyroscope_faulty="gyro" in faults,
        magnetometer_faulty="mag" in faults,
        speed_faulty="speed" in faults,
        yaw_rate_faulty="yaw_rate" in faults,
        input_rejected=is_rejecting,
        rejected=rejected,
        frames_lost=link.frames_lost,
        id_conflict=link.id_conflict,
        send_failed=link.send_failed,
        lost=link.lost,
    )
