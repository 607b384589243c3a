"""Several senders of one J1939 message, where none is configured: one of them is a sensor's.

Two sensors send the same message, each from an address of its own. Samples of both, mixed, would be
those of a sensor that does not exist.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from imucald.can.dbc.decode import J1939_ADDRESS_MASK

SENDER_SETTLING = 1.5
"""The lowest address that is heard within this from the first frame [s] is chosen: several cycles
of any sensor, so that all messages of a sensor, and every start of the program, choose alike."""


class SenderChoice:
    """Chooses one sender of a message, for good: another one may be mounted otherwise."""

    def __init__(self) -> None:
        self._address = J1939_ADDRESS_MASK + 1
        self._end = math.inf

    @property
    def address(self) -> int | None:
        """The chosen sender, None before its first frame."""
        return self._address if self._address <= J1939_ADDRESS_MASK else None

    def takes(self, t: float, can_id: int) -> bool:
        """Whether a frame at t [s] is the chosen sender's."""
        address = can_id & J1939_ADDRESS_MASK
        if address < self._address and (t <= self._end or self._end == math.inf):
            self._end = min(self._end, t + SENDER_SETTLING)
            self._address = address
        return address == self._address

    def takes_columns(
        self, t: NDArray[np.float64], can_id: NDArray[np.uint32]
    ) -> NDArray[np.bool_]:
        """`takes` of frames (N,) in order."""
        address = can_id & np.uint32(J1939_ADDRESS_MASK)
        settling = int(np.searchsorted(t, self._end, side="right"))
        if self._end == math.inf and len(t):
            self._end = float(t[0]) + SENDER_SETTLING
            settling = int(np.searchsorted(t, self._end, side="right"))
        lowest = np.full(len(t), self._address, np.int64)
        if settling:
            lowest[:settling] = np.minimum.accumulate(
                np.minimum(address[:settling], self._address).astype(np.int64)
            )
            self._address = int(lowest[settling - 1])
            lowest[settling:] = self._address
        chosen: NDArray[np.bool_] = address == lowest
        return chosen
