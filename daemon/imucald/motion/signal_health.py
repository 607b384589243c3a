"""Signal health for all users: untrusted ticks of each signal, and the reasons.

`SignalHealth` takes block after block of ticks. It runs online, without I/O and without a clock.
Every fault belongs to a signal and, if an axis can fail alone, to an axis. Estimators do not use a
tick with any fault. Reports read `found`. `physical_limits` and `stuck` define each fault with its
limits. The ticks of every fault are counted. Knowledge from ticks before a fault is kept.
`FaultsInForce` decides how long a fault lasts.
"""

from __future__ import annotations

import enum
import math
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterator, Mapping
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
    OtherSignal,
    SeenForward,
    StuckSignal,
    by_force,
    by_rolling,
    by_turning,
    latest_speed,
    zero_while_wheels_turn,
)
from imucald.motion.ticks import ACCEL, GYRO, SPEED, STEERING, TICK_S, WHEEL_SPREAD, YAW_RATE

SPREAD_FLOOR, SPREAD_SLOPE = 0.6, 0.03
"""Allowed difference between wheel speeds in addition to the effect of a curve: a constant [m/s]
and a share of the speed."""
CURVE_SHARE = 1.5
"""Allowed difference between wheel speeds in a curve, as a multiple of track times yaw rate."""


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
"""Numbers of ticks before and after a faulty tick that are not used either. The order is the order
in which faults are counted.
"""

_SIGNALS = {
    ACCEL.n: "accel", GYRO.n: "gyro", SPEED.n: "speed", STEERING.n: "steering",
    YAW_RATE.n: "yaw_rate",
}  # fmt: skip
"""Name of the signal for each column of a sample count."""


def _impossible(rows: Array) -> Iterator[tuple[int, Flags]]:
    """Yield the column of a sensor's count, and the ticks (N,) at which its values are impossible
    or NaN."""
    for count, columns, largest in MAX_TICK:
        sound = np.abs(rows[:, columns]).max(axis=1) <= largest  # False for NaN
        yield count, (rows[:, count] > 0) & ~sound


def spread_out(flags: Flags, ticks: int) -> Flags:
    """Return the flags, extended by this number of ticks to both sides."""
    out = flags.copy()
    for i in np.flatnonzero(flags):
        out[max(0, i - ticks) : i + ticks + 1] = True
    return out


def slope(values: Array) -> Array:
    """Return the slope of ticks (..., N) [1/s]. `numpy.gradient` gives the same result and takes
    six times as long.
    """
    out = np.empty_like(values)
    out[..., 1:-1] = (values[..., 2:] - values[..., :-2]) / (2.0 * TICK_S)
    out[..., 0] = (values[..., 1] - values[..., 0]) / TICK_S
    out[..., -1] = (values[..., -1] - values[..., -2]) / TICK_S
    return out


class SignalHealth:
    """Watches the signals of one vehicle and one sensor.

    new: rows of a call that no earlier call contained. Only these rows are counted. full_scale:
    full scale of the accelerometer [m/s^2]. track: distance between left and right wheels [m].
    found: flags of the faulty ticks (N,), or (N, axes), in the last block, by signal and fault. A
    fault without ticks may be absent.
    """

    def __init__(self, new: slice, full_scale: float = math.inf, track: float = 1.55) -> None:
        self._new = new
        self._full_scale, self._track = full_scale, track
        self._signals = {
            "accel": StuckSignal(ACCEL.n, slice(ACCEL.x, ACCEL.z + 1), SAME, repeats=False),
            "gyro": StuckSignal(GYRO.n, slice(GYRO.x, GYRO.z + 1), SAME, repeats=False),
            "speed": StuckSignal(SPEED.n, slice(SPEED.mean, SPEED.mean + 1), SAME_SPEED),
            "yaw_rate": StuckSignal(YAW_RATE.n, slice(YAW_RATE.mean, YAW_RATE.mean + 1), SAME),
        }
        self.counts: Counter[tuple[str, SignalFault]] = Counter()
        """Number of ticks with a fault, by signal and fault."""
        self.found: dict[tuple[str, SignalFault], Flags] = {}
        self.stuck_now: dict[str, bool] = {}
        """True or False for each judged vehicle signal: whether any new tick of the last call was
        stuck."""

    def take_usual(self, former: SignalHealth, channels: Collection[str]) -> None:
        """Copy the usual changes of these channels from another object."""
        for channel, signal in self._signals.items():
            if channel in channels:
                signal.take_usual(former._signals[channel])

    def restart(self) -> None:
        """Restart after a jump of time: ticks after the jump are not compared with ticks before
        it."""
        for signal in self._signals.values():
            signal.restart()
        self.found = {}

    @staticmethod
    def is_possible(rows: Array) -> bool:
        """Return whether ticks (N, COLUMNS) contain no impossible number."""
        return not any(bad.any() for _, bad in _impossible(rows))

    def drop_impossible(self, rows: Array) -> None:
        """Remove, in place, the sensors of new ticks that contain an impossible number or NaN."""
        for count, bad in _impossible(rows):
            if bad.any():
                rows[bad, count] = 0.0
                self._count(_SIGNALS[count], SignalFault.IMPOSSIBLE, bad)

    def stuck(self, signal: str, rows: Array) -> Flags:
        """Return the ticks (N,) at which "accel" or "gyro" is stuck. rows: (N, COLUMNS)."""
        nowhere = np.zeros(len(rows), dtype=bool)
        flags = self._flags(
            signal, rows, nowhere, lambda n: by_rolling(rows, n, moving=signal == "accel")
        )
        return self._note_stuck(signal, flags)

    def stuck_speed(self, rows: Array, seen: Callable[[], SeenForward | None]) -> Flags:
        """Return the ticks (N,) at which the speed is stuck. seen: gives what the accelerometer
        shows of the speed; None if no mount is known."""

        def witness(leaving: int) -> OtherSignal | None:
            forward = seen()
            return None if forward is None else by_force(forward, rows, leaving)

        flags = self._flags("speed", rows, latest_speed(rows) > DRIVING_SPEED, witness)
        contradicted = zero_while_wheels_turn(rows)
        # A moved sensor looks like a speed that stays, so only the wheels may accuse the speed.
        self.stuck_now["speed"] = bool(contradicted[self._new].any())
        return self._note_stuck("speed", flags | contradicted)

    def stuck_yaw_rate(self, rows: Array, turning: Array, driving: Flags) -> Flags:
        """Return the ticks (N,) at which the yaw rate is stuck.

        turning: (N,) yaw rate from another signal [rad/s]. driving: (N,) flags of the ticks in
        which the vehicle drives and `turning` is known.
        """
        flags = self._flags("yaw_rate", rows, driving, lambda _: by_turning(turning, driving))
        self.stuck_now["yaw_rate"] = bool(flags[self._new].any())
        return self._note_stuck("yaw_rate", flags)

    def _flags(
        self,
        signal: str,
        rows: Array,
        driving: Flags,
        witness: Callable[[int], OtherSignal | None],
    ) -> Flags:
        leaving = self._new.stop - self._new.start
        return self._signals[signal].flags(rows, driving, leaving, lambda: witness(leaving))

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

        rows: (N, COLUMNS). force: (N, 3) [m/s^2]. speed: (N,) [m/s]. ok_force, ok_speed: (N,) flags
        of the known values. turning: (N,) size of the yaw rate [rad/s].
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

    def _faults(
        self,
        rows: Array,
        force: Array,
        ok_force: Flags,
        speed: Array,
        ok_speed: Flags,
        turning: Array,
    ) -> dict[tuple[str, SignalFault], Flags]:
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
        n = int(np.count_nonzero(flags))
        if n:
            self.counts[signal, fault] += n


SOUND_S = 10.0
"""Time without a fault after which a sensor is used again [s].

This time is longer than the pauses of a loose contact. Each contact loss lasts for two seconds at
most.
"""
EVENTS = 50
"""Largest number of faults that are stored for the report."""

Faults = Mapping[SignalFault, str]
"""Faults and the axes that have them, such as {stuck: "y"}."""


class FaultEvent(Struct):
    """A fault that was reported. since, until: stream time [s]; until is None while the fault is
    present.

    axes: axes with the fault, such as "y"; empty for a signal without axes.
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
    """Present faults of a channel, and the time without each fault since it was last seen [s].

    events: reported faults of all channels. A fault that begins is appended. When a fault ends, the
    time of the end is stored in the reported fault.
    """

    def __init__(self, channel: str, events: deque[FaultEvent]) -> None:
        self.channel = channel
        self.faults: Faults = {}
        self._sound: dict[SignalFault, float] = {}
        self._events = events

    def go_on(self, found: Faults, now: float, passed: float) -> None:
        """Update the present faults with the faults found. A fault ends after the time `SOUND_S`
        without evidence of the fault.

        now: stream time [s]. passed: time since the last call [s].
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
        """End all faults at stream time `now` [s], because the channel is no longer watched."""
        for fault in self.faults:
            self._ended(fault, now)
        self.faults = {}

    def _ended(self, fault: SignalFault, now: float) -> None:
        for event in self._events:
            if event.channel == self.channel and event.fault is fault and event.until is None:
                event.until = now
