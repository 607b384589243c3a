"""Signal health for all users: untrusted ticks of each signal, and the reasons.

`SignalHealth` takes block after block of ticks, online and pure. Every fault is found by signal
and, where an axis can fail alone, by axis. Estimators do not use a tick with any fault; reports
read `found`. `physical_limits` and `stuck` define each fault with its limits. The ticks of every
fault are counted. A flagged tick is not used; knowledge from earlier ticks stays. `FaultsInForce`
decides how long a fault that was seen lasts.
"""

from __future__ import annotations

import enum
import math
from collections import Counter, deque
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from msgspec import Struct

from imucald.core.arrays import Array, Flags
from imucald.motion.coarse_speed import SAME_SPEED
from imucald.motion.physical_limits import (
    MAX_ROAD_DVDT,
    MAX_ROAD_RATE,
    MAX_TICK,
    ROAD_FORCE,
    saturated_axes,
)
from imucald.motion.standstill import DRIVING_SPEED
from imucald.motion.stuck import (
    SAME,
    SeenForward,
    StuckSensor,
    StuckSignal,
    by_force,
    by_turning,
    latest_speed,
    zero_while_wheels_turn,
)
from imucald.motion.ticks import ACCEL, GYRO, SPEED, STEERING, TICK_S, WHEEL_SPREAD, YAW_RATE

SPREAD_FLOOR, SPREAD_SLOPE = 0.6, 0.03
"""Wheel speeds may differ by this [m/s] and this share of the speed, beyond the curve."""
CURVE_SHARE = 1.5
"""In a curve, wheel speeds may differ by this factor times track times yaw rate."""


class SignalFault(enum.StrEnum):
    """Reason why a tick of a signal is not trusted."""

    IMPOSSIBLE = "impossible"  # an impossible number, or NaN
    STUCK = "stuck"
    IMPLAUSIBLE = "implausible"  # no road vehicle moves like this
    SATURATED = "saturated"
    WHEEL_SLIP = "wheel_slip"
    SPEED_JUMP = "speed_jump"


HOLD_TICKS: Mapping[SignalFault, int] = {
    SignalFault.IMPLAUSIBLE: 0,
    SignalFault.SATURATED: 3,
    SignalFault.WHEEL_SLIP: 10,
    SignalFault.SPEED_JUMP: 10,
}
"""Numbers of ticks around a fault that are not used either, in the order in which faults are
counted.
"""

_LIMITED = [
    (i, most, count) for count, part, most in MAX_TICK for i in range(part.start, part.stop)
]
_COLUMNS, _MOST, _COUNTS = (np.array(one) for one in zip(*_LIMITED, strict=True))
"""Columns of a tick with a largest allowed size, those sizes, and the columns of their counts."""

_SIGNALS = {
    ACCEL.n: "accel", GYRO.n: "gyro", SPEED.n: "speed", STEERING.n: "steering",
    YAW_RATE.n: "yaw_rate",
}  # fmt: skip
"""Signal names by the column of a tick's count."""


def spread_out(flags: Flags, ticks: int) -> Flags:
    """Return the flags widened by that many ticks to both sides."""
    out = flags.copy()
    for i in np.flatnonzero(flags):
        out[max(0, i - ticks) : i + ticks + 1] = True
    return out


def slope(values: Array) -> Array:
    """Return the slope of ticks (..., N) as numpy.gradient does, which takes six times as long
    [1/s].
    """
    out = np.empty_like(values)
    out[..., 1:-1] = (values[..., 2:] - values[..., :-2]) / (2.0 * TICK_S)
    out[..., 0] = (values[..., 1] - values[..., 0]) / TICK_S
    out[..., -1] = (values[..., -1] - values[..., -2]) / TICK_S
    return out


class SignalHealth:
    """Watches the signals of one vehicle and one sensor.

    full_scale: full scale of the accelerometer [m/s^2]; track: between left and right wheels [m].
    new: rows of a call that no earlier call had; these are counted. found: for the last block, by
    signal and fault, the ticks (N,), or (N, axes), with the fault; absent where there are none.
    """

    def __init__(self, new: slice, full_scale: float = math.inf, track: float = 1.55) -> None:
        self._new = new
        self._full_scale, self._track = full_scale, track
        self._sensors = {
            "accel": StuckSensor(ACCEL.n, ACCEL.x, moving=True),
            "gyro": StuckSensor(GYRO.n, GYRO.x, moving=False),
        }
        self._signals = {
            "speed": StuckSignal(SPEED.n, SPEED.mean, SAME_SPEED),
            "yaw_rate": StuckSignal(YAW_RATE.n, YAW_RATE.mean, SAME),
        }
        self.counts: Counter[tuple[str, SignalFault]] = Counter()
        """Ticks with a fault, by signal and fault."""
        self.found: dict[tuple[str, SignalFault], Flags] = {}
        self.stuck_now: dict[str, bool] = {}
        """For each judged vehicle signal, whether any new tick of the last call was stuck."""

    def take_usual(self, former: SignalHealth, channels: Collection[str]) -> None:
        """Take over what another object has learnt about these channels: how long they keep a
        value.
        """
        for channel, signal in self._signals.items():
            if channel in channels:
                signal.take_usual(former._signals[channel])

    def restart(self) -> None:
        """Restart after a jump of time: later ticks are not compared with earlier ones."""
        for sensor in self._sensors.values():
            sensor.restart()
        for signal in self._signals.values():
            signal.restart()
        self.found = {}

    @staticmethod
    def is_possible(rows: Array) -> bool:
        """Return whether ticks (N, COLUMNS) hold no impossible number, as is nearly always the
        case.
        """
        sizes, counts = np.abs(rows[:, _COLUMNS]), rows[:, _COUNTS]
        return bool(((sizes <= _MOST) | (counts == 0)).all())

    def drop_impossible(self, rows: Array) -> None:
        """Empty, in place, the sensors of new ticks that hold an impossible number or NaN."""
        if self.is_possible(rows):
            return
        for count, columns, largest in MAX_TICK:
            sound = np.abs(rows[:, columns]).max(axis=1) <= largest  # False for NaN
            bad = (rows[:, count] > 0) & ~sound
            if bad.any():
                rows[bad, count] = 0.0
                self._count(_SIGNALS[count], SignalFault.IMPOSSIBLE, bad)

    def stuck(self, signal: str, rows: Array) -> Flags:
        """Return the ticks (N,) at which "accel" or "gyro" is stuck. rows: (N, COLUMNS)."""
        return self._note_stuck(signal, self._sensors[signal].flags(rows))

    def stuck_speed(self, rows: Array, seen: SeenForward | None) -> Flags:
        """Return the ticks (N,) at which the speed is stuck. seen: None if no mount is known."""
        leaving = self._new.stop - self._new.start
        witness = None if seen is None else by_force(seen, rows, leaving)
        driving = latest_speed(rows) > DRIVING_SPEED
        flags = self._signals["speed"].flags(rows, driving, leaving, witness)
        contradicted = zero_while_wheels_turn(rows)
        # A moved sensor looks like a speed that stays, so only the wheels may accuse the speed.
        self.stuck_now["speed"] = bool(contradicted[self._new].any())
        return self._note_stuck("speed", flags | contradicted)

    def stuck_yaw_rate(self, rows: Array, turning: Array, driving: Flags) -> Flags:
        """Return the ticks (N,) at which the yaw rate is stuck.

        turning: (N,) yaw rate from another signal [rad/s]. driving: (N,) ticks where that rate is
        known and the vehicle drives.
        """
        leaving, witness = self._new.stop - self._new.start, by_turning(turning, driving)
        flags = self._signals["yaw_rate"].flags(rows, driving, leaving, witness)
        self.stuck_now["yaw_rate"] = bool(flags[self._new].any())
        return self._note_stuck("yaw_rate", flags)

    def sensor_moves(self, signal: str) -> None:
        """Take new ticks in which "accel" or "gyro" never repeats its mean and is therefore not
        stuck.
        """
        self._sensors[signal].restart()
        self.found.pop((signal, SignalFault.STUCK), None)

    def signal_moves(self, signal: str, first: float, driven: Array, change: Array) -> bool:
        """Take new ticks in which "speed" or "yaw_rate" is not stuck; return False if it must be
        judged.

        For the arguments see `StuckSignal.take_short_runs`. No speed may be zero.
        """
        if not self._signals[signal].take_short_runs(first, driven, change):
            return False
        self.stuck_now[signal] = False
        self.found.pop((signal, SignalFault.STUCK), None)
        return True

    def _note_stuck(self, signal: str, flags: Flags) -> Flags:
        self.found[signal, SignalFault.STUCK] = flags
        self._count(signal, SignalFault.STUCK, flags[self._new])
        return flags

    def untrusted(
        self,
        rows: Array,
        force: Array,
        ok_force: Flags,
        speed: Array,
        ok_speed: Flags,
        turning: Array,
    ) -> Flags:
        """Return the ticks (N,) that must not be used.

        rows: (N, COLUMNS). force: (N, 3) [m/s^2] and speed: (N,) [m/s], with flags where they are
        known. turning: (N,) size of the yaw rate [rad/s].
        """
        self.found |= self._faults(rows, force, ok_force, speed, ok_speed, turning)
        out = np.zeros(len(rows), dtype=bool)
        for fault, hold in HOLD_TICKS.items():
            for (signal, kind), flags in self.found.items():
                if kind is fault and np.count_nonzero(flags):
                    ticks = np.any(flags, axis=1) if flags.ndim > 1 else flags
                    self._count(signal, fault, ticks)
                    out |= spread_out(ticks, hold)
        return out

    def calm_blocks(
        self,
        rows: Array,
        force: Array,
        ok_force: Flags,
        speed: Array,
        ok_speed: Flags,
        turning: Array,
    ) -> list[bool]:
        """Return for blocks (B, N, COLUMNS) whether `untrusted` finds nothing in each.

        The result also holds if the vehicle turns faster, up to MAX_ROAD_RATE.
        """
        any_fault = np.zeros(len(rows), dtype=bool)
        for flags in self._faults(rows, force, ok_force, speed, ok_speed, turning).values():
            any_fault |= flags.reshape(len(rows), -1).any(axis=1)
        return [not one for one in any_fault.tolist()]

    def are_trusted(self) -> None:
        """Take new ticks in which `untrusted` finds no fault."""
        for key in [key for key in self.found if key[1] is not SignalFault.STUCK]:
            del self.found[key]

    def _faults(
        self,
        rows: Array,
        force: Array,
        ok_force: Flags,
        speed: Array,
        ok_speed: Flags,
        turning: Array,
    ) -> dict[tuple[str, SignalFault], Flags]:
        """Return the faults. The arguments are those of `untrusted`, or of several blocks (B,
        N).
        """
        low, high = ROAD_FORCE
        size2 = (force * force).sum(axis=-1)
        wild = np.abs(slope(speed)) > MAX_ROAD_DVDT
        return {
            ("accel", SignalFault.IMPLAUSIBLE): ok_force & ((size2 < low**2) | (size2 > high**2)),
            ("gyro", SignalFault.IMPLAUSIBLE): turning > MAX_ROAD_RATE,
            ("accel", SignalFault.SATURATED): saturated_axes(rows, self._full_scale),
            ("wheel_speeds", SignalFault.WHEEL_SLIP): self._slipping(rows, speed, turning),
            ("speed", SignalFault.SPEED_JUMP): ok_speed & wild,
        }

    def _slipping(self, rows: Array, speed: Array, turning: Array) -> Flags:
        known: Flags = rows[..., WHEEL_SPREAD.n] > 0
        if not np.count_nonzero(known):
            return known
        allowed = SPREAD_FLOOR + SPREAD_SLOPE * np.abs(speed)
        allowed += CURVE_SHARE * self._track * turning
        return known & (rows[..., WHEEL_SPREAD.mean] > allowed)  # False for NaN

    def _count(self, signal: str, fault: SignalFault, flags: Flags) -> None:
        """Add the flagged ticks to the count of a signal and fault."""
        n = int(np.count_nonzero(flags))
        if n:
            self.counts[signal, fault] += n


SOUND_S = 10.0
"""A sensor is used again after this time without a fault [s].

The time is longer than the pauses of a loose contact, each of which causes a loss of two seconds at
most.
"""
EVENTS = 50
"""Number of faults that are remembered for the report."""

Faults = Mapping[SignalFault, str]
"""Faults and the axes that have them, such as {stuck: "y"}."""


class FaultEvent(Struct):
    """A fault that was reported: since and until stream time [s]; None while it lasts.

    axes: such as "y"; empty for a signal that has none.
    """

    channel: str
    fault: SignalFault
    axes: str
    since: float
    until: float | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        until = None if self.until is None else round(self.until, 1)
        return {
            "sensor": self.channel,
            "fault": str(self.fault),
            "axes": self.axes,
            "since_s": round(self.since, 1),
            "until_s": until,
        }


class FaultsInForce:
    """A channel's present faults, and the time since each was last seen [s].

    events: those of all channels. A fault that begins is appended, and its end is set there.
    """

    def __init__(self, channel: str, events: deque[FaultEvent]) -> None:
        self.channel = channel
        self.faults: Faults = {}
        self._sound: dict[SignalFault, float] = {}
        self._events = events

    def go_on(self, found: Faults, now: float, passed: float) -> None:
        """Update with the faults found and with those whose absence has not lasted long enough.

        now: stream time [s]; passed: time since the last call [s].
        """
        faults = dict(self.faults)
        for fault in list(faults):
            if fault in found:
                self._sound[fault] = 0.0
            else:
                self._sound[fault] += passed
                if self._sound[fault] >= SOUND_S:
                    del faults[fault]
                    self._ended(fault, now)
        for fault, axes in found.items():
            if fault not in faults:
                self._events.append(FaultEvent(self.channel, fault, axes, now))
            faults[fault] = "".join(sorted({*faults.get(fault, ""), *axes}))
            self._sound[fault] = 0.0
        self.faults = faults

    def end(self, now: float) -> None:
        """End all faults, because nothing watches the channel any more from stream time now
        [s] on.
        """
        for fault in self.faults:
            self._ended(fault, now)
        self.faults = {}

    def _ended(self, fault: SignalFault, now: float) -> None:
        for event in self._events:
            if event.channel == self.channel and event.fault is fault and event.until is None:
                event.until = now
