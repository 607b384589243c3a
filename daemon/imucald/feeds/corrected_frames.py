"""The corrected frames of a bus, read as a careful consumer reads them (docs/output-frames.md)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from imucald.can.columns import CAN_EFF_FLAG, CAN_EFF_MASK, CAN_SFF_MASK, IdMatch
from imucald.can.e2e.protection import MessageChecker
from imucald.config import Config
from imucald.core.errors import DecodeError
from imucald.runtime.output.output_frames import OutputFrames
from imucald.runtime.output.output_message import OutputMessage

Triple = tuple[float, float, float]

STALE_S = 0.5
"""Without a good frame for so long [s] a value is not available: five periods of 10 Hz."""
RESTORED, USABLE, FINE = 1, 2, 3
GOOD = frozenset({USABLE, FINE})
"""Qualities that are handed on."""
CHANNELS = {"accel": "acceleration", "gyro": "angular_rate"}
"""Channels of the engine, and what they are called in a feed."""


class _Sum:
    """Good samples of one message since the last look."""

    def __init__(self, message: OutputMessage) -> None:
        self.message = message
        self.checker = MessageChecker(message.protection)
        self.last_good = float("-inf")
        self.clear()

    def clear(self) -> None:
        self.n, self.x, self.y, self.z = 0, 0.0, 0.0, 0.0


class CorrectedFrames:
    """Means of the corrected samples between two looks.

    accepted: qualities that count; the frames of others are as none. Checksum, counter, length and
    *not available* are obeyed.
    """

    def __init__(self, config: Config, accepted: Iterable[int] = GOOD) -> None:
        output = OutputFrames(config)
        self._accepted = frozenset(accepted)
        self._sums = {
            name: _Sum(output.message_of(channel))
            for channel, name in CHANNELS.items()
            if channel in output.triads
        }
        self._by_id = {s.message.can_id: s for s in self._sums.values()}
        self._newest: dict[str, Triple] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """What there is to read: "acceleration", "angular_rate"."""
        return tuple(self._sums)

    @property
    def matches(self) -> list[IdMatch]:
        """Which frames of the bus are wanted."""
        return [IdMatch(i, CAN_EFF_MASK if i & CAN_EFF_FLAG else CAN_SFF_MASK) for i in self._by_id]

    def take(self, t: float, can_id: int, data: bytes) -> None:
        """Take a frame received at t [s], of the clock that `means` is asked with."""
        one = self._by_id.get(can_id)
        if one is None or one.checker.check(t, data) is not None:
            return
        try:
            x, y, z, quality = one.message.values(data)
        except DecodeError:
            return
        if x is None or y is None or z is None or quality not in self._accepted:
            return
        one.n += 1
        one.x, one.y, one.z = one.x + x, one.y + y, one.z + z
        one.last_good = t

    def means(self, now: float) -> Mapping[str, Triple | None]:
        """By name the mean since the last call, in m/s^2 and deg/s; None: not available.

        Where nothing came since, the mean before stands until it is stale.
        """
        for name, one in self._sums.items():
            if one.n:
                self._newest[name] = one.x / one.n, one.y / one.n, one.z / one.n
            one.clear()
        return {
            name: self._newest.get(name) if now - one.last_good <= STALE_S else None
            for name, one in self._sums.items()
        }
