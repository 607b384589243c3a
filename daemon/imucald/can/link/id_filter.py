"""What becomes of a received frame: wanted, a conflict, an error frame, or nothing to us."""

from __future__ import annotations

import enum
from collections.abc import Iterable, Sequence

from imucald.can.columns import CAN_EFF_FLAG, CAN_EFF_MASK, CAN_SFF_MASK, IdMatch
from imucald.can.link.socketcan import CAN_ERR_FLAG, CAN_RTR_FLAG

KNOWN_IDS = 4096
"""Ids whose kind is remembered; cleared beyond, since a fuzzed bus shows any number of them."""


class FrameClass(enum.Enum):
    """What becomes of a received frame."""

    WANTED = 1
    CONFLICT = 2  # another node sends under an id of ours
    ERROR = 3
    FOREIGN = 4


class LinkIdFilter(dict[int, FrameClass]):
    """The kind of each id as the kernel writes it (with its flags), worked out once.

    This sorting is what counts; filters in the kernel or an adapter only spare us the work.
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
        """Return what to let through: the wanted ids, and ours, to see who else sends them."""
        own = [
            IdMatch(can_id, CAN_EFF_MASK if can_id & CAN_EFF_FLAG else CAN_SFF_MASK)
            for can_id in sorted(self._own_ids)
        ]
        return [*self._matches, *own]
