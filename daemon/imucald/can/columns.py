"""Data types for CAN frames: constants, columns of many frames (arrays), and id filters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from msgspec import Struct, structs
from numpy.typing import NDArray

CAN_EFF_FLAG = 0x8000_0000
"""Flag in a CAN id: the id has 29 bits (SocketCAN's flag)."""

CAN_SFF_MASK = 0x7FF
"""The bits of an 11-bit id."""

CAN_EFF_MASK = 0x1FFF_FFFF
"""The bits of a 29-bit id."""

CLASSIC_BYTES = 8
"""Largest payload of a classic CAN frame [bytes]. A frame with a larger payload is CAN FD."""

FD_BYTES = 64
"""Largest payload of a CAN FD frame [bytes]."""


FD_LENGTHS = (8, 12, 16, 20, 24, 32, 48, FD_BYTES)
"""Payload lengths of CAN FD from 8 bytes on [bytes] (ISO 11898-1)."""

CANFD_FDF = 0x04
"""Flag of a CAN FD frame: the frame has this format."""

CANFD_BRS = 1
"""Flag of a CAN FD frame: data phase at the higher bit rate, as usual in vehicles."""

CAN_RTR_FLAG = 0x4000_0000
"""Flag in a CAN id: the frame is a remote frame."""

CAN_ERR_FLAG = 0x2000_0000
"""Flag in a CAN id: the frame is an error frame. The other bits of this id are error classes."""


KNOWN_IDS = 4096
"""Largest number of ids for which a result is cached. A bus has few ids; a fuzzed bus or a damaged
log may have any number of them."""


class FrameColumns(Struct, frozen=True, eq=False):
    """N data frames in recorded order, one array for each property.

    t: (N,) f8, recorded time [s], as the log states it (not checked for order).
    can_id: (N,) u4, with `CAN_EFF_FLAG` set for 29-bit ids.
    length: (N,) u1, payload bytes 0..64.
    data: (N, W) u1, zero beyond `length`; W is 8 if no frame is longer, else 64.
    channel: (N,) u1, index into `channels`; indices are the same in all chunks of a reader.
    fd: (N,) bool, True for a frame in CAN FD format; None if there is no such frame.
    """

    t: NDArray[np.float64]
    can_id: NDArray[np.uint32]
    length: NDArray[np.uint8]
    data: NDArray[np.uint8]
    channel: NDArray[np.uint8]
    channels: tuple[str, ...]
    fd: NDArray[np.bool_] | None = None

    def __len__(self) -> int:
        return len(self.t)

    def take(self, index: NDArray[np.intp] | NDArray[np.bool_] | slice) -> FrameColumns:
        """Return the chosen frames (index array, mask or slice)."""
        if isinstance(index, slice):
            data = self.data[index]
        elif index.dtype == np.bool_:
            data = self.data.compress(index, axis=0)
        else:
            data = self.data.take(index, axis=0)  # takes whole rows; ten times as fast as [...]
        return FrameColumns(
            self.t[index],
            self.can_id[index],
            self.length[index],
            data,
            self.channel[index],
            self.channels,
            None if self.fd is None else self.fd[index],
        )

    def at(self, t: NDArray[np.float64]) -> FrameColumns:
        """Return the same frames with the times `t` (N,) [s]."""
        return structs.replace(self, t=t)

    def rows(self) -> Iterator[tuple[float, int, bytes]]:
        """Yield the frames one by one: time [s], id with the 29-bit flag, payload."""
        width, raw = self.data.shape[1], self.data.tobytes()
        columns = zip(self.t.tolist(), self.can_id.tolist(), self.length.tolist(), strict=True)
        for i, (t, can_id, length) in enumerate(columns):
            yield t, can_id, raw[i * width : i * width + length]


class IdMatch(Struct, frozen=True):
    """A filter for wanted frames: ``(id & mask) == (can_id & mask)``, as in a kernel filter.

    can_id: with `CAN_EFF_FLAG` for a 29-bit id. The flag is always compared, also if the mask does
    not contain it. channel: only frames of this channel are wanted; None means any channel.
    """

    can_id: int
    mask: int
    channel: str | None = None

    @property
    def full_mask(self) -> int:
        """Return the mask plus the flag for 29-bit ids, which is always compared."""
        return self.mask | CAN_EFF_FLAG

    def matches(self, can_id: int, channel: str) -> bool:
        """Return whether a frame with this id (with flag) on this channel is wanted."""
        if self.channel is not None and self.channel != channel:
            return False
        return not (can_id ^ self.can_id) & self.full_mask


class Channels:
    """The channels of a recording, in the order of their first frames. Indices never change."""

    def __init__(self) -> None:
        self._index: dict[str, int] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """Return all names, in the order of their indices."""
        return tuple(self._index)

    def index(self, name: str) -> int | None:
        """Return the index of a channel; a new channel is added. None if there are too many."""
        known = self._index.get(name)
        # an index is one byte; no real log has more channels
        if known is None and len(self._index) < 255:
            known = self._index[name] = len(self._index)
        return known


def concatenate(parts: Sequence[FrameColumns]) -> FrameColumns:
    """Join chunks of one reader, in order; `parts` must not be empty."""
    if len(parts) == 1:
        return parts[0]
    width = max(part.data.shape[1] for part in parts)
    any_fd = any(part.fd is not None for part in parts)
    fd = [np.zeros(len(part), np.bool_) if part.fd is None else part.fd for part in parts]
    return FrameColumns(
        np.concatenate([part.t for part in parts]),
        np.concatenate([part.can_id for part in parts]),
        np.concatenate([part.length for part in parts]),
        np.concatenate([_widened(part.data, width) for part in parts]),
        np.concatenate([part.channel for part in parts]),
        max((part.channels for part in parts), key=len),
        np.concatenate(fd) if any_fd else None,
    )


def _widened(data: NDArray[np.uint8], width: int) -> NDArray[np.uint8]:
    if data.shape[1] == width:
        return data
    wide = np.zeros((len(data), width), np.uint8)
    wide[:, : data.shape[1]] = data
    return wide
