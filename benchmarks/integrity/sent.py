"""A drive through the real engine, and what came out of it, read from the frames alone."""

from __future__ import annotations

import itertools
import math
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.integrity.bus import PROBE_IDS, probe_lengths
from imucald.can.columns import FrameColumns
from imucald.can.dbc.decode import compile_decode
from imucald.config import LoadedConfig
from imucald.core.rotations import Matrix3, rotation_from_angles
from imucald.motion.ticks import tick_index
from imucald.mount.estimate import Correction
from imucald.runtime.engine import Engine
from imucald.runtime.output.output_frames import output_database
from imucald.runtime.pipeline import Snapshot, TickCorrections
from imucald.runtime.segment_samples import SegmentSamples
from imucald.runtime.session import make_engine

Array = NDArray[np.float64]

CHUNK_S = 60.0
"""Frames are handed over in such pieces, as a log's reader does."""
USABLE, FINE, SUSPECT = 2, 3, 4
"""Qualities of a corrected frame; 0 is not available, 1 restored."""


@dataclass(frozen=True)
class Triad:
    """Corrected frames of a sensor: t (N,) [s], quality (N,)."""

    t: Array
    quality: NDArray[np.int64]

    @property
    def good(self) -> NDArray[np.bool_]:
        """Frames that say of themselves that they can be used."""
        good: NDArray[np.bool_] = (self.quality == USABLE) | (self.quality == FINE)
        return good


@dataclass(frozen=True)
class Sent:
    """What was sent.

    rotation: (seconds, 3, 3) R_vehicle_from_sensor as applied in the middle of each second, NaN
    where nothing was applied. correction: (seconds,) all that was applied then. std: (seconds, 3)
    stated deviations [deg]. sent_std: (seconds, 8) those of `force.ENTRIES`. crash: what ended it.
    """

    accel: Triad
    gyro: Triad | None
    rotation: Array
    correction: Sequence[Correction | None]
    std: Array
    sent_std: Array
    crash: str | None


def sent(frames: FrameColumns, loaded: LoadedConfig, seconds: int) -> Sent:
    """Take frames through an engine of this configuration; an exception ends it and is told."""
    applied: list[Correction | None] = [None] * seconds
    watch = _Watch(applied)
    engine = make_engine(loaded, on_samples=watch.take)
    watch.hang_on(engine)
    edges = np.searchsorted(frames.t, np.arange(0.0, seconds + CHUNK_S, CHUNK_S)).tolist()
    parts: list[FrameColumns] = []
    crash = None
    for first, stop in itertools.pairwise(edges):
        try:
            with np.errstate(all="ignore"):  # what is sent is judged, not how it came about
                out = engine.columns(frames.take(slice(first, stop))) if stop > first else None
        except Exception as error:  # the daemon would end here, whatever it is
            where = traceback.extract_tb(error.__traceback__)[-1]
            crash = f"{type(error).__name__} in {where.name}"
            break
        if out is not None:
            parts.append(out)
    ids = loaded.config.output.ids
    accel = _triad(parts, "IMUCALD_Acceleration", ids.acceleration)
    has_gyro = loaded.config.signals.gyroscope is not None
    gyro = _triad(parts, "IMUCALD_AngularRate", ids.angular_rate) if has_gyro else None
    middles: Array = np.arange(seconds, dtype=np.float64) + 0.5
    std, cross_talk, zero = (
        _deviations(parts, message, can_id, names, middles)
        for message, can_id, names in (
            ("IMUCALD_MountDeviation", ids.mount_deviation, ("X", "Y", "Z")),
            ("IMUCALD_CrossTalkDeviation", ids.cross_talk_deviation, ("XY", "YX", "ZX", "ZY")),
            ("IMUCALD_ZeroDeviation", ids.zero_deviation, ("ZeroX", "ZeroY", "RateXZ", "RateYZ")),
        )
    )
    rotation = _rotation(parts, ids.mount, middles)
    return Sent(accel, gyro, rotation, applied, std, np.hstack([cross_talk, zero]), crash)


class _Watch:
    """Keeps what an engine applies in the middle of each second of its frames' stamps.

    Frames carry samples, not matrices: of a matrix and an offset the probes show too little.
    """

    def __init__(self, applied: list[Correction | None]) -> None:
        self._applied = applied
        self._newest: TickCorrections | None = None

    def hang_on(self, engine: Engine) -> None:
        """Take the corrections of each run of its pipeline."""
        run = engine.pipeline.run

        def watched(*arguments: Any) -> tuple[TickCorrections, list[Snapshot]]:
            self._newest, snapshots = run(*arguments)
            return self._newest, snapshots

        engine.pipeline.run = watched  # type: ignore[method-assign]

    def take(self, samples: SegmentSamples) -> None:
        """Take the seconds of a segment, whose corrections came just before."""
        found, stamps = self._newest, samples.stamps
        assert found is not None
        first, last = math.ceil(stamps[0] - 0.5), math.floor(stamps[-1] - 0.5)
        for second in range(max(first, 0), min(last + 1, len(self._applied))):
            row = int(np.searchsorted(stamps, second + 0.5, side="right")) - 1
            tick = tick_index(float(samples.segment.t[row])) - found.first
            self._applied[second] = found.corrections[tick]


def _deviations(
    parts: Sequence[FrameColumns], message: str, can_id: int, names: Sequence[str], middles: Array
) -> Array:
    std = _latest(parts, message, can_id, [f"Deviation{name}" for name in names], middles)
    # Good from the middle of a second on: its deviation is told at the second's end.
    unsaid = np.flatnonzero(np.isnan(std[:-1]).any(axis=1))
    std[unsaid] = std[unsaid + 1]
    return std


def _triad(parts: Sequence[FrameColumns], message: str, can_id: int) -> Triad:
    t, values = _decoded(parts, message, can_id, ["Quality"])
    return Triad(t, values[:, 0].astype(np.int64))


def _decoded(
    parts: Sequence[FrameColumns], message: str, can_id: int, names: Sequence[str]
) -> tuple[Array, Array]:
    """Times (N,) and values (N, names) of a message; what is not available is NaN."""
    found = output_database().message(message)
    plan = compile_decode(found, list(names))
    times, rows = [np.zeros(0)], [np.zeros((0, len(names)))]
    for part in parts:
        mine = part.take(part.can_id == can_id)
        columns = plan.decode_columns(mine.data, mine.length)
        values = np.column_stack(columns.values) if len(mine) else np.zeros((0, len(names)))
        for i, (name, raw) in enumerate(zip(names, columns.raw, strict=True)):
            signal = found.signal(name)
            if signal.length == 16:
                values[raw == (-32768 if signal.is_signed else 65535), i] = np.nan
            elif signal.length == 12:
                values[raw == 4095, i] = np.nan
        times.append(mine.t)
        rows.append(values)
    return np.concatenate(times), np.concatenate(rows)


def _latest(
    parts: Sequence[FrameColumns], message: str, can_id: int, names: Sequence[str], t: Array
) -> Array:
    """Values (len(t), names) that were the last heard at each time."""
    when, values = _decoded(parts, message, can_id, names)
    rows = np.searchsorted(when, t, side="right") - 1
    out = np.full((len(t), len(names)), np.nan)
    out[rows >= 0] = values[rows[rows >= 0]]
    return out


def _rotation(parts: Sequence[FrameColumns], mount_id: int, middles: Array) -> Array:
    """From the probes; from the mount frame where they are silent."""
    out = np.full((len(middles), 3, 3), np.nan)
    lengths = probe_lengths(len(middles))
    columns = []
    for can_id in PROBE_IDS:
        t, values = _decoded(parts, "IMUCALD_Acceleration", can_id, ["AccelX", "AccelY", "AccelZ"])
        column = np.full((len(middles), 3), np.nan)
        row = np.clip(np.floor(t).astype(np.int64), 0, len(middles) - 1)
        column[row] = values / lengths[row, None]
        columns.append(column)
    out[:, :, 0], out[:, :, 1] = columns
    out[:, :, 2] = np.cross(columns[0], columns[1])
    angles = _latest(
        parts, "IMUCALD_Mount", mount_id, ["MountRoll", "MountPitch", "MountYaw"], middles
    )
    for k in np.flatnonzero(np.isnan(out).any(axis=(1, 2)) & np.isfinite(angles).all(axis=1)):
        out[k] = _from_angles(angles[k])
    return out


def _from_angles(degrees: Array) -> Matrix3:
    roll, pitch, yaw = np.radians(degrees).tolist()
    return rotation_from_angles(roll, pitch, yaw)
