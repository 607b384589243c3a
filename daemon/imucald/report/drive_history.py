"""Data of a replay for its page: samples, corrected frames and snapshots, by time.

Corrected values are decoded from the frames that were sent. The decoded values are therefore the
values that a control unit would have received.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from imucald.can.columns import FrameColumns
from imucald.core.arrays import Array
from imucald.core.samples import Samples, Series, direction_at
from imucald.motion.ticks import TICK_RATE
from imucald.mount.estimate import MountEstimate
from imucald.runtime.engine import Engine
from imucald.runtime.output.output_message import NOT_AVAILABLE_SIGNED, output_database
from imucald.runtime.pipeline import Snapshot
from imucald.runtime.segment_samples import SegmentSamples

CORRECTED = {
    "accel": ("IMUCALD_Acceleration", "AccelX"),
    "gyro": ("IMUCALD_AngularRate", "RateX"),
}
"""For each sensor: name of the message, and name of the first of its three signals. All three
signals have the same scale."""
_TO_SI = {"accel": 1.0, "gyro": np.pi / 180.0}
WINDOW_TICKS = 5
"""Length of the mean for comparing forces with the change of speed [ticks of 0.1 s]: half a second.

Over a shorter time, the resolution of the speed signal dominates. Over a longer time, short
manoeuvres are not visible."""
HOLE_S = 2.5
"""Longest gap between speed samples that is interpolated [s]. The slowest OBD-II speed has one
sample per second."""


@dataclass(frozen=True)
class Moment:
    """A snapshot of the estimate. t: stream time [s]."""

    t: float
    estimate: MountEstimate


@dataclass(frozen=True)
class DriveMotion:
    """Means over half a second, in vehicle axes unless stated otherwise; (N,) and (N, 3), SI.

    raw: specific force in sensor axes. corrected: corrected specific force as sent; NaN if not
    available. dvdt: change of speed; turn: speed times yaw rate; NaN if not known.
    """

    t: Array
    raw: Array
    corrected: Array
    speed: Array
    dvdt: Array
    turn: Array


@dataclass
class DriveHistory:
    """Collects samples, frames and snapshots during a replay, and returns them in order after the
    replay."""

    moments: list[Moment] = field(default_factory=list)
    gaps: list[float] = field(default_factory=list)
    """Stream times of time jumps [s]."""

    def __post_init__(self) -> None:
        self.duration_s = 0.0
        """Stream time of the last configured frame [s]."""
        self.lead = 0.0
        """Time from the start of the log to the first configured frame [s]. Stream time begins at
        this frame."""
        self._parts: dict[str, list[Series]] = {}
        self._rejected: dict[str, list[Array]] = {}
        self._corrected: dict[str, list[Series]] = {}
        self._clock: list[tuple[Array, Array]] = []

    # while the replay runs -------------------------------------------------------------------

    def samples(self, part: SegmentSamples) -> None:
        """Store the decoded samples of a segment."""
        t = part.segment.t
        if part.segment.gap:
            self.gaps.append(float(t[0]))
        self.duration_s = float(t[-1])
        for channel, series in part.as_sensed.items():
            self._parts.setdefault(channel, []).append(Series(series.t, series.values))
        for channel, rows in part.rejected.items():
            self._rejected.setdefault(channel, []).append(t[rows])
        self._clock.append((part.stamps, t))

    def snapshot(self, snapshot: Snapshot) -> None:
        """Store a snapshot of the estimate."""
        self.moments.append(Moment(snapshot.t, snapshot.estimate))

    def begins(self, lead: float) -> None:
        """Store the time from the start of the log to the first configured frame [s]."""
        self.lead = lead

    def sink(self, engine: Engine) -> Callable[[FrameColumns], None]:
        """Return a function that stores the frames which the engine sends."""
        nothing = np.zeros((0, 3)), np.zeros(0, np.uint8)
        ids = {
            engine.output.corrected_columns(channel, *nothing)[0]: channel
            for channel in CORRECTED
            if channel in engine.output.triads
        }

        def take(frames: FrameColumns) -> None:
            for can_id, channel in ids.items():
                rows = frames.can_id == can_id
                if rows.any():
                    values = _decoded(channel, frames.data[rows])
                    t = self._stream_times(frames.t[rows])
                    self._corrected.setdefault(channel, []).append(Series(t, values))
            self._clock.clear()  # these frames answer all samples so far

        return take

    def _stream_times(self, stamps: Array) -> Array:
        known, times = (np.concatenate(parts) for parts in zip(*self._clock, strict=True))
        order = np.argsort(known, kind="stable")
        rows = np.searchsorted(known[order], stamps).clip(max=len(known) - 1)
        return np.asarray(times[order][rows])

    # afterwards ------------------------------------------------------------------------------

    @property
    def all_samples(self) -> Samples:
        """Return all good samples by channel, SI."""
        return {channel: joined(parts) for channel, parts in sorted(self._parts.items())}

    @property
    def rejected(self) -> Mapping[str, Array]:
        """Times of rejected samples [s], by channel."""
        return {c: np.concatenate(parts) for c, parts in sorted(self._rejected.items())}

    def motion(self) -> DriveMotion:
        """Return specific forces and the motion of the vehicle."""
        samples = self.all_samples
        n = max(int(self.duration_s * TICK_RATE) + 1, WINDOW_TICKS + 1)
        edges = np.arange(n + 1) / TICK_RATE
        corrected = {c: joined(parts) for c, parts in self._corrected.items()}
        wide = np.full((n, 3), np.nan)
        means = {
            name: _tick_means(series, edges) if series is not None else wide
            for name, series in (
                ("raw", samples.get("accel")),
                ("corrected", corrected.get("accel")),
                ("rate", corrected.get("gyro")),
            )
        }
        speed = _signed_speed(samples, edges)
        if "yaw_rate" in samples:
            yaw_rate = _tick_means(samples["yaw_rate"], edges)[:, 0]
        else:
            yaw_rate = means["rate"][:, 2]
        middle = 0.5 * (speed[1:] + speed[:-1])
        seconds = WINDOW_TICKS / TICK_RATE
        return DriveMotion(
            0.5 * (edges[WINDOW_TICKS:] + edges[:-WINDOW_TICKS]),
            _window(means["raw"]),
            _window(means["corrected"]),
            _window(middle),
            (speed[WINDOW_TICKS:] - speed[:-WINDOW_TICKS]) / seconds,
            _window(middle * yaw_rate),
        )


def joined(parts: Sequence[Series]) -> Series:
    """Join the pieces of one channel into one series."""
    return Series(np.concatenate([p.t for p in parts]), np.concatenate([p.values for p in parts]))


def _decoded(channel: str, data: NDArray[np.uint8]) -> Array:
    """Decode corrected values (N, 3) in SI from payloads (N, 8); NaN if not available."""
    raw = np.ascontiguousarray(data[:, :6]).view("<i2").astype(np.float64)
    message, signal = CORRECTED[channel]
    scale = output_database().message(message).signal(signal).scale
    raw[raw == NOT_AVAILABLE_SIGNED] = np.nan
    return np.asarray(raw * scale * _TO_SI[channel])


def _tick_means(series: Series, edges: Array) -> Array:
    """Return the means of the samples in each tick, (n, width); NaN for a tick without samples.
    edges: times of the edges of the ticks [s]."""
    values = series.values if series.values.ndim == 2 else series.values[:, None]
    n = len(edges) - 1
    tick = np.clip((series.t * TICK_RATE).astype(np.int64), 0, n - 1)
    count = np.bincount(tick, minlength=n).astype(np.float64)
    count[count == 0.0] = np.nan
    columns = [np.bincount(tick, values[:, i], n) / count for i in range(values.shape[1])]
    return np.stack(columns, axis=1)


def _signed_speed(samples: Samples, edges: Array) -> Array:
    """Return the speed at the edges of ticks, negative in reverse; NaN if no sample is near."""
    series = samples.get("speed")
    if series is None and "wheel_speeds" in samples:
        wheels = samples["wheel_speeds"]
        series = Series(wheels.t, wheels.values.mean(axis=1))
    if series is None or not len(series.t):
        return np.full(len(edges), np.nan)
    speed = np.interp(edges, series.t, series.values)
    after = np.searchsorted(series.t, edges).clip(1, max(len(series.t) - 1, 1))
    if len(series.t) > 1:
        hole = series.t[after] - series.t[after - 1] > HOLE_S
        outside = (edges < series.t[0] - HOLE_S) | (edges > series.t[-1] + HOLE_S)
        speed[hole | outside] = np.nan
    return speed * direction_at(samples.get("reverse"), edges)


def _window(x: Array) -> Array:
    """Return the moving means of x over `WINDOW_TICKS` ticks; NaN if a tick in the window is
    NaN."""
    wide = x if x.ndim == 2 else x[:, None]
    pieces = np.lib.stride_tricks.sliding_window_view(wide, WINDOW_TICKS, axis=0)
    means = np.asarray(pieces.mean(axis=-1))
    return means if x.ndim == 2 else means[:, 0]
