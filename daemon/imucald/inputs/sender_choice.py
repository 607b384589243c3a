"""Choose one of several senders of a J1939 message, if no sender is configured.

Two sensors may send the same message, each with its own address. Their samples must not be mixed.
The accelerometer of one sensor must not be combined with the gyroscope of the other either.
Therefore an address that sends more of the sensor's messages is preferred.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.can.columns import FrameColumns
from imucald.can.dbc.decode import J1939_ADDRESS_MASK
from imucald.core.arrays import Flags

SENDER_SETTLING = 1.5
"""Time after the first frame in which candidate addresses are collected [s]. The time covers
several cycles of any sensor. Therefore all messages of a sensor, and each start of the program,
make the same choice."""
AS_OFTEN = 2
"""A candidate must send at least 1 / AS_OFTEN of the number of frames of the most frequent
candidate. Therefore a unit that sends a single frame at its start is no candidate."""
NOT_AVAILABLE = 0xFF
"""If all bytes of a payload have this value, the payload contains no data (J1939-71, 5.1.4). Such a
payload is ignored in the choice."""

Rows = NDArray[np.int64]


class SenderChoice:
    """Chooses one sender of a message. The choice is permanent, because another sender is another
    sensor with another mount.

    All senders are accepted until a frame with data arrives.
    """

    def __init__(self) -> None:
        self.sensor: Sequence[SenderChoice] = (self,)
        """The choices of all messages of the sensor."""
        self._counts: Counter[int] = Counter()
        self._address: int | None = None
        self._end = math.inf

    @property
    def address(self) -> int | None:
        """The address of the chosen sender; None before the first frame with data."""
        return self._address

    @property
    def _candidates(self) -> list[int]:
        least = max(self._counts.values()) / AS_OFTEN
        return [address for address, count in self._counts.items() if count >= least]

    def is_settled(self, t: float) -> bool:
        """True if the choice is final at t [s]."""
        return t > self._end

    def takes(self, t: float, can_id: int, data: bytes) -> bool:
        """True if a frame at t [s] is from the chosen sender."""
        address = can_id & J1939_ADDRESS_MASK
        if not self.is_settled(t) and data.count(NOT_AVAILABLE) < len(data):
            self._end = min(self._end, t + SENDER_SETTLING)
            self._counts[address] += 1
            self._address = min(
                self._candidates, key=lambda one: (-sum(one in s._counts for s in self.sensor), one)
            )
        return self._address is None or address == self._address


class Asked(Struct, frozen=True, eq=False):
    """Frames of one message in a chunk: their rows (N,) and times (N,)."""

    choice: SenderChoice
    rows: Rows
    t: NDArray[np.float64]


def joined(choices: Iterable[SenderChoice]) -> None:
    """Make all messages of one sensor choose the same sender."""
    sensor = tuple(choices)
    for choice in sensor:
        choice.sensor = sensor


def taken(frames: FrameColumns, asked: Sequence[Asked]) -> list[Flags]:
    """Apply `SenderChoice.takes` to the frames of all messages, in the order of their rows."""
    flags = [np.ones(len(one.rows), dtype=bool) for one in asked]
    events: list[tuple[int, int, int]] = []
    for k, one in enumerate(asked):
        if not one.choice.is_settled(float(one.t[0])):
            events += [(row, k, i) for i, row in enumerate(one.rows.tolist())]
        elif one.choice.address is not None:
            address = frames.can_id.take(one.rows) & np.uint32(J1939_ADDRESS_MASK)
            flags[k] = address == one.choice.address
    for row, k, i in sorted(events):
        data = frames.data[row, : int(frames.length[row])].tobytes()
        t, can_id = float(asked[k].t[i]), int(frames.can_id[row])
        flags[k][i] = asked[k].choice.takes(t, can_id, data)
    return flags
