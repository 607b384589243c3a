"""One output message: encoding, and protection with counter and checksum.

A message is compiled for its first frame, or by `prepare`. A replay without output frames therefore
never reads the output database.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache, cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imucald.can.columns import CAN_EFF_FLAG
from imucald.can.dbc.database import Database, load_database_text
from imucald.can.dbc.decode import DecodePlan, compile_decode
from imucald.can.dbc.encode import EncodePlan, compile_encode
from imucald.can.dbc.message import Message
from imucald.can.e2e.checksum_engine import ChecksumSpec
from imucald.can.e2e.checksums import NO_CHECKSUM, ONE_BYTE_KINDS
from imucald.can.e2e.protection_spec import ProtectionSpec, counter_of
from imucald.can.e2e.protector import MessageProtector
from imucald.config import STANDARD_ID_MAX

OutFrame = tuple[int, bytes]
"""CAN id (with the flag for 29 bits) and payload."""

OUTPUT_DATABASE = Path(__file__).parents[2] / "data" / "imucald_out.dbc"
NOT_AVAILABLE_SIGNED = -32768
NOT_AVAILABLE_UNSIGNED = 65535
NOT_AVAILABLE_12 = 4095
"""Raw value for *not available* of unsigned signals with 12 bits."""


@cache
def output_database() -> Database:
    """Return the database of the frames that imucald sends."""
    text = OUTPUT_DATABASE.read_text("utf-8")
    return load_database_text(text, "dbc", "imucald_out.dbc")


class OutputMessage:
    """Encodes the frames of one message. A value that does not fit is sent as *not available*; a
    deviation or count is sent as the largest one.

    message: name of the message in `output_database`. not_available: for each signal name, the raw
    value for *not available*.
    """

    def __init__(
        self,
        message: str,
        signals: Sequence[str],
        can_id: int,
        checksum: str,
        not_available: Mapping[str, int],
    ) -> None:
        self.can_id = can_id | (CAN_EFF_FLAG if can_id > STANDARD_ID_MAX else 0)
        self._message = message
        self._signals = tuple(signals)
        self._not_available = not_available
        self._kind = checksum
        self._bare_id = can_id

    @cached_property
    def _plan(self) -> EncodePlan:
        message = output_database().message(self._message)
        return compile_encode(message, self._signals, self._not_available)

    @cached_property
    def _limits(self) -> list[tuple[int, float]]:
        """Positions and largest numbers of deviations and counts. A larger number is sent as the
        largest, because it must not look unknown."""
        message = output_database().message(self._message)
        return [
            (i, message.signal(name).maximum or 0.0)
            for i, name in enumerate(self._signals)
            if name.startswith("Deviation") or name.endswith("Count")
        ]

    @cached_property
    def _protector(self) -> MessageProtector:
        return MessageProtector(self.protection)

    @cached_property
    def protection(self) -> ProtectionSpec:
        """The protection of the frames, as needed to check received frames."""
        message = output_database().message(self._message)
        return ProtectionSpec(
            size=message.length,
            counter=counter_of(message.signal("Counter")),
            checksum=_checksum(self._kind, self._bare_id, message),
        )

    @cached_property
    def _reading(self) -> DecodePlan:
        return compile_decode(output_database().message(self._message), self._signals)

    def values(self, payload: bytes) -> list[float | None]:
        """Return the values in a frame, in the units of the message; None means *not available*.

        The method is the inverse of `frame`. Raises DecodeError if the frame is too short.
        """
        raw = self._reading.decode_raw(payload)
        known = [
            self._not_available.get(name) != r for name, r in zip(self._signals, raw, strict=True)
        ]
        scaled = self._reading.scale(raw)
        return [v if is_known else None for v, is_known in zip(scaled, known, strict=True)]

    @property
    def key(self) -> tuple[str, int]:
        """Name and id of the message. For receivers, messages with the same key are the same
        message."""
        return self._message, self.can_id

    def go_on_from(self, before: OutputMessage) -> None:
        """Continue the counter from the last frame of the same message."""
        self._protector.go_on_from(before._protector)

    def prepare(self) -> None:
        """Compile the message now, so that the first frame takes no longer than later frames."""
        _ = self._plan, self._protector, self._limits

    @cached_property
    def _nothing(self) -> bytes:
        """Payload in which all values are *not available* and state or quality is 0, before
        protection."""
        return self._plan.encode([*(None for _ in self._signals[1:]), 0])

    def not_available(self) -> OutFrame:
        """Return a frame in which all values are *not available*. The last signal (state or
        quality) is 0.
        """
        return self.can_id, self._protector.protect(self._nothing)

    def frame(self, values: Sequence[float | None]) -> OutFrame:
        """Return a frame with the given values, in the units of the message; None means *not
        available*."""
        if self._limits:
            values = list(values)
            for i, largest in self._limits:
                value = values[i]
                values[i] = None if value is None else min(value, largest)
        return self.can_id, self._protector.protect(self._plan.encode(values))

    def payloads(self, columns: Sequence[NDArray[np.float64]]) -> NDArray[np.uint8]:
        """Return payloads (N, length) of columns (N,); NaN means *not available*."""
        return self._protector.protect_columns(self._plan.encode_columns(columns))


def _checksum(kind: str, can_id: int, message: Message) -> ChecksumSpec | None:
    if kind == NO_CHECKSUM:
        return None
    id_bytes = can_id.to_bytes(4 if can_id > STANDARD_ID_MAX else 2, "big")
    return ONE_BYTE_KINDS[kind](message.length, message.length - 1, id_bytes)
