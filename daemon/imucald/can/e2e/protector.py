"""Protect sent frames: alive counter, data id, checksum."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imucald.can.dbc.bits import Columns, Field, write_bits, write_column
from imucald.can.e2e.checksum_engine import Checksum
from imucald.can.e2e.protection_spec import ProtectionSpec
from imucald.core.errors import EncodeError


class MessageProtector:
    """Writes alive counter, data id and checksum into the encoded frames of one message.

    The counter starts at 0 and increases by 1 per frame, for single frames and for columns.
    """

    def __init__(self, spec: ProtectionSpec) -> None:
        self.spec = spec
        self._next = 0
        self._checksum = None if spec.checksum is None else Checksum(spec.checksum)

    def go_on_from(self, before: MessageProtector) -> None:
        """Continue the counter of the previous protector of this message."""
        self._next = before._next

    def protect(self, data: bytes | bytearray) -> bytes:
        """Return the protected frame. Raises EncodeError if the frame is too short."""
        self._refuse_short(len(data))
        payload = bytearray(data)
        counter = self.spec.counter
        if counter is not None:
            write_bits(payload, counter.field, self._next)
            self._next = (self._next + 1) % counter.modulus
        if self._checksum is not None:
            spec = self._checksum.spec
            if spec.fixed is not None:
                write_bits(payload, *spec.fixed)
            end = spec.position + spec.width
            value = self._checksum.compute(payload)
            payload[spec.position : end] = value.to_bytes(spec.width, spec.byte_order)
        return bytes(payload)

    def protect_columns(self, data: Columns) -> Columns:
        """Return the protected frames (N, W). The bytes are the same as for single frames."""
        count, width = data.shape
        self._refuse_short(width)
        out = np.zeros((count, -(-width // 8) * 8), np.uint8)
        out[:, :width] = data
        counter = self.spec.counter
        if counter is not None:
            values = (self._next + np.arange(count)) % counter.modulus
            _overwrite(out, counter.field, values.astype(np.uint64))
            self._next = (self._next + count) % counter.modulus
        if self._checksum is not None:
            spec = self._checksum.spec
            if spec.fixed is not None:
                field, value = spec.fixed
                _overwrite(out, field, np.full(count, value, np.uint64))
            crc = self._checksum.compute_columns(out)
            for shift, place in spec.bytes_at():
                out[:, place] = (crc >> np.uint16(shift)) & np.uint16(0xFF)
        return np.ascontiguousarray(out[:, :width])

    def _refuse_short(self, length: int) -> None:
        if length < self.spec.size:
            raise EncodeError(f"a frame of {length} bytes is too short for its protection")


def _overwrite(out: Columns, field: Field, values: NDArray[np.uint64]) -> None:
    keep = bytearray(b"\xff" * out.shape[1])
    write_bits(keep, field, 0)
    out &= np.frombuffer(keep, np.uint8)
    write_column(out, field, values)
