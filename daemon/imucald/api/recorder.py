"""Collect the output of an engine during a replay in tables."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucald.api.columns import (
    EVENT_COLUMNS,
    HISTORY_COLUMNS,
    RAW,
    Columns,
    columns_from,
    corrected_columns,
    raw_columns,
)
from imucald.core.angles import DEG_PER_RAD
from imucald.core.arrays import Array
from imucald.motion.ticks import TICK_RATE
from imucald.mount.angle_deviations import angle_deviations
from imucald.mount.estimate import MountEstimate
from imucald.mount.mount_words import is_move, moved_words
from imucald.runtime.engine import Engine
from imucald.runtime.pipeline import Snapshot
from imucald.runtime.segment_samples import SegmentSamples

MAX_EVENTS = 10_000
"""Largest number of stored events. If a log has more events, its frames are not in order or its
clock is broken."""
BLOCK_ROWS = 1000
"""When the history has this many new rows, they are moved to an array of numbers."""
SHIFT = "shift"
"""Kind of event: the sensor was moved."""
LATEST_US = 2**62
"""Limit of times of day [us], so that a damaged time stamp cannot overflow."""
_UPPER = (0, 1, 2, 4, 5, 8)
"""The upper triangle of a 3 x 3 matrix, row by row: xx, xy, xz, yy, yz, zz."""


class Recorder:
    """Collects history, events and (with `signals`) samples. The engine calls the methods of the
    recorder."""

    def __init__(self, signals: bool) -> None:
        self._signals = signals
        self._states: list[str] = []
        self._rows: list[list[float]] = []
        self._blocks: list[Array] = []
        self._seen: MountEstimate | None = None
        self._known: MountEstimate | None = None
        self._figures: list[float] = []
        self._events: list[tuple[float, str, str]] = []
        self.events_left_out = 0
        self._state = "waiting"
        self._faults: tuple[str, ...] = ()
        self._shifts: list[Mapping[str, Any]] = []
        self._segments: list[tuple[float, float]] = []  # stream time of the start, stamp minus it
        self._last_stamp = math.nan
        self._parts: dict[str, list[deque[NDArray[Any]]]] = {}
        self.rows = 0
        """Number of sample rows that `take_signals` has not returned yet."""

    # what the engine calls -----------------------------------------------------------------

    def snapshot(self, snapshot: Snapshot) -> None:
        """Receive an estimate. Only estimates at whole seconds are stored."""
        self._take_changes(snapshot)
        if (snapshot.k + 1) % round(TICK_RATE) == 0:
            estimate = snapshot.estimate
            if estimate is not self._known:
                self._known, self._figures = estimate, _history_figures(estimate)
            self._states.append(self._state)
            self._rows.append([snapshot.t, float(snapshot.usable), *self._figures])
            if len(self._rows) == BLOCK_ROWS:
                self._blocks.append(np.array(self._rows))
                self._rows = []

    def samples(self, found: SegmentSamples) -> None:
        """Receive the samples of a segment."""
        segment, stamps = found.segment, found.stamps
        t = segment.t
        if segment.gap:
            self._event(float(t[0]), "segment", _gap_text(self._last_stamp, float(stamps[0])))
        if segment.gap or not self._segments:
            # a stamp a little out of order lies behind stream time: the largest one does not
            self._segments.append((float(t[0]), float(np.max(stamps - t))))
        self._last_stamp = float(np.max(stamps))
        if not self._signals:
            return
        times = microseconds(stamps)
        for channel, one in found.corrected().items():
            of = one.t, times[one.row], *_by_axis(one.values), one.quality.view(np.int8)
            self._put(channel, of)
        for channel, series in found.as_sensed.items():
            self._put(f"{RAW}{channel}", (series.t, times[series.row], *_by_axis(series.values)))

    def _put(self, name: str, columns: Sequence[NDArray[Any]]) -> None:
        parts = self._parts.setdefault(name, [deque() for _ in columns])
        for column, part in zip(parts, columns, strict=True):
            column.append(part)
        self.rows += len(columns[0])

    def _take_changes(self, snapshot: Snapshot) -> None:
        estimate = snapshot.estimate
        if estimate is self._seen:
            return
        self._seen = estimate
        state = estimate.state.name.lower()
        if state != self._state:
            self._state = state
            self._event(snapshot.t, "state", state)
        for fault in estimate.faults:
            if fault not in self._faults:
                self._event(snapshot.t, "contradiction", fault)
        self._faults = estimate.faults
        shifts = estimate.details.get("shifts")
        if isinstance(shifts, list) and len(shifts) >= len(self._shifts):
            # the size of each shift is known only some time after the shift was detected
            for _ in shifts[len(self._shifts) :]:
                self._event(snapshot.t, SHIFT, "")
            self._shifts = shifts

    def _event(self, t: float, kind: str, text: str) -> None:
        if len(self._events) < MAX_EVENTS:
            self._events.append((t, kind, text))
        else:
            self.events_left_out += 1

    # the results ---------------------------------------------------------------------------

    def history(self, lead: float) -> Columns:
        """Return the estimates at whole seconds of stream time; lead: see `runtime.replay`."""
        rows = np.array(self._rows).reshape(len(self._rows), len(HISTORY_COLUMNS) - 2)
        t, usable, *rest = np.concatenate([*self._blocks, rows]).T
        times = [t + lead, self._times(t)]
        return columns_from(HISTORY_COLUMNS, [*times, self._states, usable > 0.0, *rest])

    def events(self, lead: float, engine: Engine) -> Columns:
        """Return the events: changes of state, shifts of the mount, contradictions, new segments,
        sensor faults."""
        rows = [*self._events, *_sensor_faults(engine)]
        times, kinds, texts = ([row[column] for row in rows] for column in range(3))
        turns = np.full((3, len(rows)), math.nan)
        rows_of_shifts = [i for i, kind in enumerate(kinds) if kind == SHIFT]
        for i, shift in zip(rows_of_shifts, self._shifts, strict=False):  # the last may be missing
            kinds[i], texts[i] = SHIFT if is_move(shift) else "evidence", moved_words(shift)
            if shift["turn_deg"]:
                turns[:, i] = shift["turn_deg"]
        t = np.array(times, dtype=float)
        found = columns_from(EVENT_COLUMNS, [t + lead, self._times(t), kinds, texts, *turns])
        return found.sorted_by_time()

    def take_signals(self, lead: float, kinds: Mapping[str, str]) -> dict[str, Columns]:
        """Return the samples since the last call, by table. kinds: the kind of sensor of each
        channel."""
        taken, self._parts, self.rows = self._parts, {}, 0
        found: dict[str, Columns] = {}
        for name, parts in taken.items():
            channel = name.removeprefix(RAW)
            kind = kinds.get(channel, channel)
            columns = raw_columns(channel, kind) if name != channel else corrected_columns(kind)
            arrays = [_joined(column) for column in parts]
            arrays[0] += lead
            found[name] = columns_from(columns, arrays)
        return found

    def _times(self, t: Array) -> NDArray[np.int64]:
        if not self._segments:
            return np.zeros(len(t), np.int64)
        starts, offsets = np.array(self._segments).T
        of = np.maximum(np.searchsorted(starts, t, side="right") - 1, 0)
        return microseconds(t + offsets[of])


def _joined(parts: deque[NDArray[Any]]) -> NDArray[Any]:
    """Join the parts of a column and drop them, so that only one column is there twice."""
    whole = np.concatenate(parts)
    parts.clear()
    return whole


def _history_figures(e: MountEstimate) -> list[float]:
    """Return the numbers of a row of the history, beginning with the column roll_deg."""
    nothing = (math.nan,)
    angles = list(nothing * 3 if e.angles is None else (a * DEG_PER_RAD for a in e.angles))
    quaternion = nothing * 4 if e.quaternion is None else e.quaternion
    covariance: Any = nothing * 6
    deviations: Any = nothing * 3
    if e.covariance is not None and e.R_vehicle_from_sensor is not None:
        flat = e.covariance.ravel().tolist()
        covariance = [flat[i] * DEG_PER_RAD**2 for i in _UPPER]
        of_angles = angle_deviations(e.R_vehicle_from_sensor, e.covariance.tolist())
        deviations = [s * DEG_PER_RAD if math.isfinite(s) else math.nan for s in of_angles]
        if math.isnan(deviations[2]):  # the yaw value has no meaning
            angles[2] = math.nan
    return [*angles, *quaternion, *covariance, *deviations]


def _gap_text(before: float, stamp: float) -> str:
    change = stamp - before
    return f"hole of {change:.1f} s" if change > 0 else f"clock set back by {-change:.1f} s"


def _sensor_faults(engine: Engine) -> list[tuple[float, str, str]]:
    found = []
    for event in engine.pipeline.health.summary()["events"]:
        until = event["until_s"]
        end = "to the end" if until is None else f"until {until:.1f} s"
        text = f"{event['sensor']} {event['fault']} {event['axes']} {end}"
        found.append((float(event["since_s"]), "sensor_fault", text))
    return found


def _by_axis(values: Array) -> Array:
    return np.atleast_2d(values.T)


def microseconds(stamps: Array) -> NDArray[np.int64]:
    """Convert time stamps [s] to whole microseconds."""
    exact = stamps * 1e6
    np.rint(exact, out=exact)
    return np.clip(exact, -LATEST_US, LATEST_US, out=exact).astype(np.int64)
