"""The transport protocol of J1939 (SAE J1939-21): find messages that are sent in several frames.

A separate frame announces such a message (TP.CM: BAM to all units, RTS to one unit). The announcing
frame contains the PGN and the length of the message.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imucald.can.columns import CAN_EFF_FLAG, CLASSIC_BYTES, IdMatch

ANNOUNCEMENT = IdMatch(CAN_EFF_FLAG | 0xEC_0000, 0x03FF_0000)
"""Frames that announce a message or answer an announcement, to any address."""


def announced_messages(
    can_id: NDArray[np.uint32], data: NDArray[np.uint8], length: NDArray[np.uint8]
) -> dict[int, int]:
    """Return the length [bytes] of each message announced in frames (N,).

    can_id: with the flag for 29 bits. data: (N, 8) or wider. The keys of the result are the ids
    that the messages would have as single frames, without priority.
    """
    mask, wanted = ANNOUNCEMENT.full_mask, ANNOUNCEMENT.can_id
    here = (can_id & np.uint32(mask) == wanted) & (length == CLASSIC_BYTES)
    if not here.any():
        return {}
    bytes_, sender = data[here].astype(np.uint32), can_id[here] & np.uint32(0xFF)
    is_first = np.isin(bytes_[:, 0], (16, 32))  # request to send, to all units
    pgn = bytes_[:, 5] | bytes_[:, 6] << 8 | (bytes_[:, 7] & 3) << 16
    ids = (pgn << 8 | sender | np.uint32(CAN_EFF_FLAG))[is_first]
    sizes = (bytes_[:, 1] | bytes_[:, 2] << 8)[is_first]
    return dict(zip(ids.tolist(), sizes.tolist(), strict=True))


def in_transport(size: int) -> str:
    """Return a text about a message in transport frames, with a remedy. size: length [bytes]."""
    return (
        f"its PGN comes in several frames ({size} bytes, transport protocol of J1939), which "
        "imucald does not read; set the sensor to messages of 8 bytes"
    )
