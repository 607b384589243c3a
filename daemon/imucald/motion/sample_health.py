"""Decide, with every sample, which sensors are usable for sending and for learning.

`SampleHealth` uses hops of half a second (`hops`). Live operation and columns give bit-equal
results. A fault begins at the end of the hop in which it was found. The fault ends when the sensor
has had no fault for `signal_health.SOUND_S`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucald.core.angles import DEG_PER_RAD
from imucald.core.arrays import Array, Flags
from imucald.core.samples import Samples, Series
from imucald.motion.hops import HOP_S, HOP_TICKS, AxisHops, Carry, HopRows, hop_rows
from imucald.motion.rails import SURPRISE as RAIL
from imucald.motion.rails import AxisRails
from imucald.motion.sensor_judges import (
    FORCE_HOPS,
    RATE_HOPS,
    AxisRuns,
    Lasting,
    UnitChange,
    turning_wildly,
    unlike_gravity,
)
from imucald.motion.sensor_judges import SURPRISE as STUCK
from imucald.motion.signal_health import EVENTS, FaultEvent, Faults, FaultsInForce, SignalFault
from imucald.motion.standstill import ROLLING_SPEED
from imucald.motion.ticks import TICK_RATE

SPEED_HOPS = 6
"""Number of hops (3 s) for which a received speed counts as known. 3 s are enough for a source of
one sample per second that loses two samples.
"""
BRAKING = 4.0
"""Largest assumed braking of the vehicle since its speed was last received [m/s^2]."""
NOISE: Mapping[str, float] = {"accel": 0.0018, "gyro": 0.00012, "mag": 8e-8}
"""Noise densities of consumer sensors per root of hertz: 180 ug, 0.007 deg/s (BMI160 data sheet),
and 0.6 uT rms at 20 Hz and more (BMM150 data sheet, regular preset). For the magnetic field, the
value used here is lower than the value of the data sheet: 0.08 uT.
"""
WATCHED = ("accel", "gyro", "mag")
AXES = "xyz"
_UNITS = {"gyro": DEG_PER_RAD}

_More = tuple[Array, NDArray[np.int64]]
"""Samples and the hop (half a second) of each sample."""


class AxisJudges:
    """The tests of one axis for faults.

    noise: see `AxisRuns`. surprises: two limits of -log of the probability of the data without a
    fault [nats], the first for a stuck run, the second for a rail.
    """

    def __init__(self, noise: float, surprises: tuple[float, float] = (STUCK, RAIL)) -> None:
        self.runs = AxisRuns(noise, surprises[0])
        self._surprise = surprises[1]
        self.forget_rails()

    def forget_rails(self) -> None:
        """Forget all evidence so far about the ends of the range."""
        self.rails = AxisRails(self._surprise)

    def judge(self, at: AxisHops, moving: Flags) -> tuple[list[bool], list[bool], list[bool]]:
        """Return three flags for each hop (half a second).

        The first flag is True if the axis is stuck at the end of the hop. The second flag is True
        if a run between two jumps ended in the hop. The third flag is True if the axis is on a rail
        at the end of the hop. All flags of a hop without samples are False.
        """
        runs = self.runs
        stuck, lost, saturated = ([False] * len(moving) for _ in range(3))
        for h, is_moving in enumerate(moving.tolist()):
            at.runs.append((runs.moving.count, runs.moving.longest))
            if at.counts[h][0]:
                was_stuck = runs.stuck
                stuck[h], lost[h] = runs.take_hop(at, h, is_moving)
                saturated[h] = self.rails.take_hop(at, h, is_moving, was_stuck)
        return stuck, lost, saturated


class _Sensor(FaultsInForce):
    """One sensor: its samples of the open hop (half a second), the tests of its axes, and the
    faults that were found."""

    def __init__(self, channel: str, axes: int, events: deque[FaultEvent]) -> None:
        super().__init__(channel, events)
        self.axes = axes
        self.pending: list[Sequence[float]] = []
        self.carry = Carry.none(axes)
        self.judges = [AxisJudges(NOISE[channel]) for _ in range(axes)]
        self._wild = Lasting(FORCE_HOPS if channel == "accel" else RATE_HOPS)
        self._unit = UnitChange(_UNITS[channel], axes) if channel in _UNITS else None

    def restart(self) -> None:
        self.pending = []
        self.carry.restart()
        for judge in self.judges:
            judge.runs.restart()
        if self._unit is not None:
            self._unit.restart()

    def rows(self, hops: int, more: _More | None) -> HopRows | None:
        """Return the statistics of this many hops, or None without samples.

        The samples are the pending samples, which belong to the first hop (half a second), and the
        new samples `more`.
        """
        pending, self.pending = self.pending, []
        values, hop = more if more is not None else (np.zeros((0, 3)), np.zeros(0, np.int64))
        if pending:
            values = np.concatenate([np.array(pending), values])
            hop = np.concatenate([np.zeros(len(pending), np.int64), hop])
        if not len(values):
            return None
        return hop_rows(values[:, : self.axes], hop, hops, self.carry)

    def judge(
        self, rows: HopRows, moving: Flags, other: Array
    ) -> list[dict[SignalFault, str] | None]:
        """Return the faults found in each hop (half a second); None for a hop without samples."""
        wild = np.zeros(len(moving), dtype=bool)
        some = rows.count > 0
        if self.axes == 3 and self.channel == "accel":
            wild[some] = self._wild.take_hops(unlike_gravity(rows.mean[:, some]))
        if self.channel == "gyro":
            wild[some] = self._wild.take_hops(turning_wildly(rows.mean[:, some]))
        if self._unit is not None:
            of = rows.level[:, some].T, rows.ended[:, some].T
            wild[some] |= self._unit.take_hops(*of, other[some], moving[some])
        each = [judge.judge(AxisHops(axis, rows), moving) for axis, judge in enumerate(self.judges)]
        shown = [(SignalFault.STUCK, AXES[i], stuck) for i, (stuck, _, _) in enumerate(each)]
        shown += [(SignalFault.STUCK, AXES[i], lost) for i, (_, lost, _) in enumerate(each)]
        shown += [(SignalFault.SATURATED, AXES[i], on) for i, (_, _, on) in enumerate(each)]
        shown += [(SignalFault.IMPLAUSIBLE, AXES[: self.axes], wild.tolist())]
        counts = rows.count.tolist()
        found: list[dict[SignalFault, str]] = [{} for _ in counts]
        for fault, axes, flags in shown:
            if True in flags:
                for h, flag in enumerate(flags):
                    if flag and axes not in found[h].get(fault, ""):
                        found[h][fault] = "".join(sorted(found[h].get(fault, "") + axes))
        return [faults if count else None for faults, count in zip(found, counts, strict=True)]


class SampleHealth:
    """Watches the sensors of one unit.

    axes: number of measured axes of each channel (a planar accelerometer has two).
    """

    def __init__(self, axes: Mapping[str, int]) -> None:
        self.events: deque[FaultEvent] = deque(maxlen=EVENTS)
        self._sensors = {c: _Sensor(c, axes[c], self.events) for c in WATCHED if c in axes}
        self._speed, self._speed_age = 0.0, SPEED_HOPS
        self._moved = False
        self._heard: float | None = None
        self.faults: Mapping[str, Faults] = {}
        """Present faults of each channel whose sensor cannot be used now."""
        self.signals: Mapping[str, Faults] = {}
        """Present faults of the vehicle's signals. The estimator tests these signals block by
        block."""
        self._signals: dict[str, FaultsInForce] = {}
        self._signals_at = 0.0

    def go_on_from(
        self, former: SampleHealth, same: Collection[str], now: float, with_signals: bool = True
    ) -> None:
        """Continue from another object: take over its present faults and the usual behaviour of
        each sensor.

        same: channels with the same sources in both objects. The other channels start without
        knowledge, and their faults end. now: stream time [s]. with_signals: if False, the faults of
        the vehicle's signals end too, because no estimator tests the signals any more.
        """
        self.events = former.events
        for channel, sensor in self._sensors.items():
            known = former._sensors.get(channel) if channel in same else None
            if known is None or known.axes != sensor.axes:
                known = _Sensor(channel, sensor.axes, self.events)
            self._sensors[channel] = known
        self.faults = {c: s.faults for c, s in self._sensors.items() if s.faults}
        if with_signals:
            self._signals = {c: s for c, s in former._signals.items() if c in same}
        self._signals_at = former._signals_at
        self.signals = {c: s.faults for c, s in self._signals.items() if s.faults}
        kept = [*self._sensors.values(), *self._signals.values()]
        for one in (*former._sensors.values(), *former._signals.values()):
            if one not in kept:
                one.end(now)
        if "speed" in same:
            self._speed, self._speed_age = former._speed, former._speed_age
            self._moved, self._heard = former._moved, former._heard

    # live ----------------------------------------------------------------------------------

    def add_sample(self, channel: str, values: Sequence[float]) -> None:
        """Process a sample of the open hop (half a second), as the sensor sent it."""
        sensor = self._sensors.get(channel)
        if sensor is not None:
            sensor.pending.append(values)
        elif channel == "speed":
            self._heard = values[0]

    def close(self, k: int) -> None:
        """Note that tick k is over."""
        if (k + 1) % HOP_TICKS == 0:
            self._take([self._heard], (k + 1) // HOP_TICKS - 1, {})
            self._heard = None

    def forget_rails(self) -> None:
        """Forget all evidence so far about the ends of the axes' ranges."""
        for sensor in self._sensors.values():
            for judge in sensor.judges:
                judge.forget_rails()

    def gap(self) -> None:
        """Note a jump of time: samples before the jump are not joined with samples after it."""
        for sensor in self._sensors.values():
            sensor.restart()
        self._speed_age, self._moved, self._heard = SPEED_HOPS, False, None

    # columns -------------------------------------------------------------------------------

    def columns(self, samples: Samples, first: int, last: int) -> list[Mapping[str, Faults]]:
        """Process all samples of ticks `first` to `last`. Tick `last` may get more samples later.

        Returns the faults at the end of each complete hop (half a second).
        """
        begin = first // HOP_TICKS
        hops = last // HOP_TICKS - begin
        speeds: list[float | None] = [self._heard] + [None] * hops
        series = samples.get("speed")
        if series is not None and len(series.t):
            of = _hop_of(series, begin)
            ends = np.append(np.flatnonzero(np.diff(of)), len(of) - 1)
            for hop, value in zip(of[ends].tolist(), series.values[ends].tolist(), strict=True):
                speeds[hop] = value
        self._heard = speeds.pop()
        taken: dict[str, _More] = {}
        rest: dict[str, Array] = {}
        for channel in self._sensors:
            series = samples.get(channel)
            if series is not None:
                of = _hop_of(series, begin)
                done = int(np.searchsorted(of, hops))
                taken[channel] = series.values[:done], of[:done]
                rest[channel] = series.values[done:]
        found = self._take(speeds, begin, taken) if hops else []
        for channel, values in rest.items():
            self._sensors[channel].pending += values.tolist()
        return found

    # both ----------------------------------------------------------------------------------

    def _take(
        self, speeds: Sequence[float | None], first: int, more: Mapping[str, _More]
    ) -> list[Mapping[str, Faults]]:
        """Find the faults in hops `first`, `first` + 1, and so on.

        speeds: last received speed of each hop (half a second) [m/s], None without a speed; there
        are as many hops as speeds. more: samples of channels with their hops, counted from `first`.
        The samples in `more` are used after the pending samples.
        """
        moves = [self._is_moving(speed) for speed in speeds]
        moving = np.array(moves)
        rows = {c: s.rows(len(moves), more.get(c)) for c, s in self._sensors.items()}
        level = {c: _change_of_all(r) for c, r in rows.items() if r is not None}
        nothing = np.zeros((len(moving), 2))
        found = {}
        for channel, sensor in self._sensors.items():
            of = rows[channel]
            if of is not None:
                other = level.get("accel" if channel == "gyro" else "gyro", nothing)
                found[channel] = sensor.judge(of, moving, other)
        out: list[Mapping[str, Faults]] = []
        for h in range(len(moves)):
            for channel, faults in found.items():
                now = faults[h]
                if now or (now is not None and channel in self.faults):
                    self._keep(self._sensors[channel], now, (first + h + 1) * HOP_S)
            out.append(self.faults)
        return out

    def _is_moving(self, speed: float | None) -> bool:
        """Return whether the vehicle moved during the whole hop (half a second) according to the
        speeds.
        """
        self._speed_age += 1
        if speed is not None:
            self._speed, self._speed_age = speed, 0
        least = ROLLING_SPEED + BRAKING * HOP_S * self._speed_age
        moves = self._speed_age < SPEED_HOPS and abs(self._speed) > least
        before, self._moved = self._moved, moves
        return moves and before

    @property
    def unfit(self) -> Mapping[str, Faults]:
        """For each channel, the faults of all sensors and signals that cannot be used now."""
        return {**self.faults, **self.signals} if self.signals else self.faults

    def take_signals(self, stuck: Mapping[str, bool], now: float) -> None:
        """Store a flag for each vehicle signal: whether it was stuck in the block that ends at
        `now` [s]."""
        passed, self._signals_at = now - self._signals_at, now
        for channel, is_stuck in stuck.items():
            signal = self._signals.setdefault(channel, FaultsInForce(channel, self.events))
            if is_stuck or signal.faults:
                signal.go_on({SignalFault.STUCK: ""} if is_stuck else {}, now, passed)
        self.signals = {c: s.faults for c, s in self._signals.items() if s.faults}

    def summary(self) -> dict[str, Any]:
        """Return, for JSON, the present faults of each watched sensor and signal, and the reported
        faults.
        """
        unfit = self.unfit
        return {
            "sensors": {
                channel: {str(fault): axes for fault, axes in unfit.get(channel, {}).items()}
                for channel in (*self._sensors, *self._signals)
            },
            "events": [event.as_dict() for event in self.events],
        }

    def _keep(self, sensor: _Sensor, found: Mapping[SignalFault, str], now: float) -> None:
        sensor.go_on(found, now, HOP_S)
        others = {c: f for c, f in self.faults.items() if c != sensor.channel}
        self.faults = {**others, sensor.channel: sensor.faults} if sensor.faults else others


def _change_of_all(rows: HopRows) -> Array:
    """Return two columns (H, 2): the mean change of the vector from sample to sample, and the
    number of changes of the axis that changes most often.
    """
    level = np.sqrt((rows.level * rows.level).sum(axis=0))
    return np.column_stack([level, rows.ended.max(axis=0)])


def _hop_of(series: Series, first: int) -> NDArray[np.int64]:
    return np.floor(series.t * TICK_RATE).astype(np.int64) // HOP_TICKS - first
