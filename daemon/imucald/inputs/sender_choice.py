"""Several senders of one J1939 message, where none is configured: one of them is a sensor's.

Two sensors send the same message, each from an address of its own. Samples of both, mixed, would be
those of a sensor that does not exist. So would be the accelerometer of one and the gyroscope of the
other: an address that sends more of the sensor's messages goes before one that sends fewer.
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

SENDER_SETTLING = 1.5
"""Addresses that are heard within this from the first frame [s] are chosen from: several cycles
of any sensor, so that all messages of a sensor, and every start of the program, choose alike."""
AS_OFTEN = 2
"""Of these only such as send at least the half of what the busiest one sends: a stray frame of a
unit that starts is no sensor."""
NOT_AVAILABLE = 0xFF
"""A payload of nothing but these says nothing (J1939-71, 5.1.4): no choice is made of it."""

Rows = NDArray[np.int64]
Flags = NDArray[np.bool_]


class SenderChoice:
    """Chooses one sender of a message, for good: another one may be mounted otherwise.

    Until there is a frame that says something, all are taken.
    """

    def __init__(self) -> None:
        self.sensor: Sequence[SenderChoice] = (self,)
        """Those of all messages of the sensor."""
        self._counts: Counter[int] = Counter()
        self._address: int | None = None
        self._end = math.inf

    @property
    def address(self) -> int | None:
        """The chosen sender, None before its first frame."""
        return self._address

    @property
    def _candidates(self) -> list[int]:
        least = max(self._counts.values()) / AS_OFTEN
        return [address for address, count in self._counts.items() if count >= least]

    def is_settled(self, t: float) -> bool:
        """Whether nothing is chosen any more at t [s]."""
        return t > self._end

    def takes(self, t: float, can_id: int, data: bytes) -> bool:
        """Whether a frame at t [s] is the chosen sender's."""
        address = can_id & J1939_ADDRESS_MASK
        if not self.is_settled(t) and data.count(NOT_AVAILABLE) < len(data):
            self._end = min(self._end, t + SENDER_SETTLING)
            self._counts[address] += 1
            self._address = min(
                self._candidates, key=lambda one: (-sum(one in s._counts for s in self.sensor), one)
            )
        return self._address is None or address == self._address

    def choosing(self, frames: FrameColumns, rows: Rows, t: NDArray[np.float64]) -> tuple[int, int]:
        """The first of frames (N,) of which a choice is made, and the first after the choice."""
        end, first = self._end, 0
        if math.isinf(end):
            length = np.arange(frames.data.shape[1]) < frames.length[rows][:, None]
            says = ((frames.data[rows] != NOT_AVAILABLE) & length).any(axis=1)
            if not says.any():
                return len(rows), len(rows)
            first = int(np.argmax(says))
            end = float(t[first]) + SENDER_SETTLING
        return first, int(t.searchsorted(end, side="right"))


class Asked(Struct, frozen=True, eq=False):
    """Frames of one message of a chunk: their rows (N,) in it and times (N,)."""

    choice: SenderChoice
    rows: Rows
    t: NDArray[np.float64]


def joined(choices: Iterable[SenderChoice]) -> None:
    """Have the messages of one sensor choose alike."""
    sensor = tuple(choices)
    for choice in sensor:
        choice.sensor = sensor


def taken(frames: FrameColumns, asked: Sequence[Asked]) -> list[Flags]:
    """`SenderChoice.takes` of the frames of each of the messages, in the order of their rows."""
    flags = [np.ones(len(one.rows), dtype=bool) for one in asked]
    events: list[tuple[int, int, int]] = []
    stops = []
    for k, one in enumerate(asked):
        first, stop = one.choice.choosing(frames, one.rows, one.t)
        events += [(int(one.rows[i]), k, i) for i in range(first, stop)]
        stops.append(stop)
    for row, k, i in sorted(events):
        data = frames.data[row, : int(frames.length[row])].tobytes()
        t, can_id = float(asked[k].t[i]), int(frames.can_id[row])
        flags[k][i] = asked[k].choice.takes(t, can_id, data)
    for one, flag, stop in zip(asked, flags, stops, strict=True):
        if one.choice.address is not None:
            address = frames.can_id.take(one.rows[stop:]) & np.uint32(J1939_ADDRESS_MASK)
            flag[stop:] = address == one.choice.address
    return flags
