"""Data of a replay for its page: snapshots, times of samples, and the motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from imucald.config_check.motion import TickMeans
from imucald.core.arrays import Array
from imucald.core.samples import Series, width_of
from imucald.motion.ticks import TICK_RATE
from imucald.runtime.pipeline import Snapshot
from imucald.runtime.segment_samples import SegmentSamples

WINDOW_TICKS = 5
"""Length of the mean for comparing forces with the change of speed [ticks of 0.1 s]: half a second.

Over a shorter time, the resolution of the speed signal dominates. Over a longer time, short
manoeuvres are not visible."""


@dataclass(frozen=True)
class DriveMotion:
    """Means over half a second, in vehicle axes unless stated otherwise; (N,) and (N, 3), SI.

    raw: specific force in sensor axes. corrected: corrected specific force; NaN if not available.
    dvdt: change of speed; turn: speed times yaw rate; NaN if not known.
    """

    t: Array
    raw: Array
    corrected: Array
    speed: Array
    dvdt: Array
    turn: Array


@dataclass
class DriveHistory:
    """Collects samples and snapshots during a replay, and returns them in order after the
    replay."""

    moments: list[Snapshot] = field(default_factory=list)
    gaps: list[float] = field(default_factory=list)
    """Stream times of time jumps [s]."""
    duration_s: float = 0.0
    """Stream time of the last configured frame [s]."""
    lead: float = 0.0
    """Time from the start of the log to the first configured frame [s]. Stream time begins at this
    frame."""
    _means: TickMeans = field(default_factory=TickMeans)
    _arrivals: dict[str, list[Array]] = field(default_factory=dict)
    _rejected: dict[str, list[Array]] = field(default_factory=dict)

    def samples(self, part: SegmentSamples) -> None:
        """Store the samples of a segment."""
        t = part.segment.t
        if part.segment.gap:
            self.gaps.append(float(t[0]))
        self.duration_s = float(t[-1])
        for channel, series in part.as_sensed.items():
            self._arrivals.setdefault(channel, []).append(series.t)
        for channel, rows in part.rejected.items():
            self._rejected.setdefault(channel, []).append(t[rows])
        self._means.add_samples(part.as_sensed)
        for channel, found in part.corrected().items():
            self._means.add_samples({f"corrected/{channel}": Series(found.t, found.values)})

    def snapshot(self, snapshot: Snapshot) -> None:
        """Store a snapshot of the estimate."""
        self.moments.append(snapshot)

    @property
    def arrivals(self) -> Mapping[str, Array]:
        """Times of good samples [s], by channel."""
        return _by_channel(self._arrivals)

    @property
    def rejected(self) -> Mapping[str, Array]:
        """Times of rejected samples [s], by channel."""
        return _by_channel(self._rejected)

    def motion(self) -> DriveMotion:
        """Return specific forces and the motion of the vehicle, in the first two hours."""
        grid = self._means.grid()
        n = max([WINDOW_TICKS + 1, *map(len, grid.values())])

        def known(channel: str) -> Array:
            shape = (n,) if width_of(channel) == 1 else (n, width_of(channel))
            values = np.full(shape, np.nan)
            if channel in grid:
                values[: len(grid[channel])] = grid[channel]
            return values

        speed = known("speed") if "speed" in grid else known("wheel_speeds").mean(axis=1)
        speed = np.where(known("reverse") > 0.5, -speed, speed)
        yaw_rate = known("yaw_rate") if "yaw_rate" in grid else known("corrected/gyro")[:, 2]
        edges = np.concatenate([speed[:1], 0.5 * (speed[1:] + speed[:-1]), speed[-1:]])
        return DriveMotion(
            np.arange(0.5 * WINDOW_TICKS, n + 1 - 0.5 * WINDOW_TICKS) / TICK_RATE,
            _window(known("accel")),
            _window(known("corrected/accel")),
            _window(speed),
            (edges[WINDOW_TICKS:] - edges[:-WINDOW_TICKS]) * (TICK_RATE / WINDOW_TICKS),
            _window(speed * yaw_rate),
        )


def _by_channel(parts: Mapping[str, list[Array]]) -> dict[str, Array]:
    return {channel: np.concatenate(parts[channel]) for channel in sorted(parts)}


def _window(x: Array) -> Array:
    """Return the moving means of x (n,) or (n, w) over `WINDOW_TICKS` ticks; NaN if a tick in the
    window is NaN."""
    pieces = np.lib.stride_tricks.sliding_window_view(x, WINDOW_TICKS, axis=0)
    return np.asarray(pieces.mean(axis=-1))
