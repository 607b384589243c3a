"""Filter frames by id: in columns of a recording, and one by one on a live link."""

from __future__ import annotations

import enum
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from imucald.can.columns import (
    CAN_EFF_FLAG,
    CAN_EFF_MASK,
    CAN_ERR_FLAG,
    CAN_RTR_FLAG,
    CAN_SFF_MASK,
    KNOWN_IDS,
    IdMatch,
)

UNWANTED, WANTED, NO_ID = np.uint8(0), np.uint8(1), np.uint8(2)
"""The results of an `IdFilter` for an 11-bit id."""


class IdFilter:
    """The wanted ids, compiled for columns. Each channel has its own filter, since a match may be
    for one channel only."""

    def __init__(self, keep: Sequence[IdMatch] | None, channel: str) -> None:
        """keep: filters of the wanted ids; None means that all ids are wanted."""
        ours = [m for m in keep or () if m.channel is None or m.channel == channel]
        self.everything = keep is None
        standard = [m for m in ours if not m.can_id & CAN_EFF_FLAG]
        extended = {
            (m.can_id & m.mask & CAN_EFF_MASK, m.mask & CAN_EFF_MASK)
            for m in ours
            if m.can_id & CAN_EFF_FLAG
        }
        ids = np.arange(CAN_SFF_MASK + 1, dtype=np.uint32)
        wanted = np.full(len(ids), self.everything)
        for m in standard:
            wanted |= ((ids ^ np.uint32(m.can_id)) & np.uint32(m.mask & CAN_EFF_MASK)) == 0
        self.verdict = np.full(16**3, NO_ID, np.uint8)
        """(4096,) u1: WANTED, UNWANTED or (above 7FF) NO_ID. The index is an id of three
        hexadecimal digits."""
        self.verdict[: len(ids)] = np.where(wanted, WANTED, UNWANTED)
        self.exact = np.array(sorted(i for i, m in extended if m == CAN_EFF_MASK), np.uint32)
        """Wanted 29-bit ids (N,) with a full mask. All other 29-bit filters are pairs of id and
        mask."""
        self.masked = sorted(pair for pair in extended if pair[1] != CAN_EFF_MASK)

    def extended(self, ids: NDArray[np.uint32]) -> NDArray[np.bool_]:
        """Return which 29-bit ids (N,), without flag, are wanted."""
        if self.everything:
            return np.ones(len(ids), np.bool_)
        wanted = np.isin(ids, self.exact) if len(self.exact) else np.zeros(len(ids), np.bool_)
        for can_id, mask in self.masked:
            wanted |= (ids & np.uint32(mask)) == np.uint32(can_id)
        return wanted

    def wanted(self, can_id: int) -> bool:
        """Return whether the id of one frame (with flag) is wanted."""
        if can_id & CAN_EFF_FLAG:
            return bool(self.extended(np.array([can_id & CAN_EFF_MASK], np.uint32))[0])
        return bool(self.verdict[can_id] == WANTED)


class IdFilters:
    """The filter of each channel. The filter is made at the first frame of the channel."""

    def __init__(self, keep: Sequence[IdMatch] | None) -> None:
        self._keep = keep
        self._of: dict[str, IdFilter] = {}

    def filter_of(self, channel: str) -> IdFilter:
        """Return the filter of a channel. Ask only for channels that `Channels` accepted."""
        if channel not in self._of:
            self._of[channel] = IdFilter(self._keep, channel)
        return self._of[channel]


class FrameClass(enum.Enum):
    """How a received frame is treated."""

    WANTED = 1
    CONFLICT = 2  # another node sends with one of our ids
    ERROR = 3
    FOREIGN = 4


class LinkIdFilter(dict[int, FrameClass]):
    """A dictionary from an id (with the kernel's flags) to the class of its frames. The class is
    computed once per id.

    Filters in the kernel or adapter only reduce the work; this dictionary makes the decision.
    """

    def __init__(self, matches: Sequence[IdMatch], own_ids: Iterable[int], channel: str) -> None:
        super().__init__()
        self._matches = tuple(match for match in matches if match.channel in (None, channel))
        self._own_ids = frozenset(own_ids)
        self._channel = channel

    def __missing__(self, can_id: int) -> FrameClass:
        if len(self) >= KNOWN_IDS:
            self.clear()
        self[can_id] = kind = self._work_out(can_id)
        return kind

    def _work_out(self, can_id: int) -> FrameClass:
        if can_id & CAN_ERR_FLAG:
            return FrameClass.ERROR
        if can_id & CAN_RTR_FLAG:  # carries no data
            return FrameClass.FOREIGN
        if can_id in self._own_ids:
            return FrameClass.CONFLICT
        if any(match.matches(can_id, self._channel) for match in self._matches):
            return FrameClass.WANTED
        return FrameClass.FOREIGN

    def filters(self) -> list[IdMatch]:
        """Return the filters for the kernel: wanted ids, and own ids to detect other senders."""
        own = [
            IdMatch(can_id, CAN_EFF_MASK if can_id & CAN_EFF_FLAG else CAN_SFF_MASK)
            for can_id in sorted(self._own_ids)
        ]
        return [*self._matches, *own]
