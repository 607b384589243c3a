"""Read data by identifier (service 0x22): the identifiers and the format of their data.

Numbers are big endian, as everywhere in ISO 14229. A special raw value means that a value is
unknown.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from imucald.core.text import encodable
from imucald.mount.estimate import ANGLES
from imucald.uds.codes import Answer, Nrc
from imucald.uds.host import Host

MAX_IDENTIFIERS = 16
"""Largest number of identifiers in a request. The limit bounds the work and the response."""
MAX_RESPONSE = 512
"""Longest response [bytes]. A request for a longer response is refused."""

ANGLE_NOT_KNOWN = -0x8000
DEVIATION_NOT_KNOWN = 0xFFFF

COUNTED_FAULTS = (
    "short_frame",
    "checksum",
    "counter_invalid",
    "counter_repeated",
    "counter_reversed",
    "counter_jump",
    "too_early",
    "untrusted",
    "not_available",
    "not_finite",
    "saturated",
    "out_of_range",
)
"""Reasons for rejecting frames, in the order in which their counts are in the identifier's data."""


@dataclass(frozen=True)
class Identifier:
    """A data identifier: its name, and a function that returns its data bytes (None: not supported
    now)."""

    name: str
    read: Callable[[Host], bytes | None]


def _angles(host: Host) -> bytes:
    """Return the mount angles in the format of the mount frame. The angles are unknown while no
    correction is active."""
    angles = host.estimate().angles if host.quality else None
    raw = (ANGLE_NOT_KNOWN,) * 3 if angles is None else [_angle(a) for a in angles]
    return struct.pack(">3h", *raw)


def _angle(value: float) -> int:
    raw = round(math.degrees(value) / 0.01)
    return raw if -0x7FFF <= raw <= 0x7FFF else ANGLE_NOT_KNOWN


def _deviations(host: Host) -> bytes:
    """Return the deviations of the mount angles, also before a correction is usable, because they
    show the progress."""
    std = host.estimate().std
    raw = (DEVIATION_NOT_KNOWN,) * 3 if std is None else [_deviation(s) for s in std]
    return struct.pack(">3H", *raw)


def _deviation(value: float) -> int:
    if not math.isfinite(value):
        return DEVIATION_NOT_KNOWN
    return min(round(math.degrees(value) / 0.005), DEVIATION_NOT_KNOWN - 1)


def _quaternion(host: Host) -> bytes:
    found = host.estimate().quaternion if host.quality else None
    return struct.pack(">4f", *(found or (math.nan,) * 4))


def _state(host: Host) -> bytes:
    return bytes([host.estimate().state])


def _waiting(host: Host) -> bytes:
    missing = host.estimate().missing
    return bytes([missing.get(angle, 0) for angle in ANGLES])


def _counters(host: Host) -> bytes:
    c = host.counts()
    return u32(c.received, c.used, c.rejected, c.lost, c.conflicts, c.sent)


def _faults(host: Host) -> bytes:
    faults = host.counts().faults
    return u32(*(faults.get(reason, 0) for reason in COUNTED_FAULTS))


def u32(*values: int) -> bytes:
    """Return counters as four bytes each; a larger number is sent as the largest."""
    return struct.pack(f">{len(values)}I", *(min(v, 0xFFFF_FFFF) for v in values))


def _vin(host: Host) -> bytes | None:
    """Return the vehicle's identity if it has the form of a VIN."""
    text = host.identity.vehicle
    ok = len(text) == 17 and text.isascii() and text.isalnum()
    return text.encode("ascii") if ok else None


IDENTIFIERS: Mapping[int, Identifier] = {
    0xF18A: Identifier("system supplier", lambda _: b"imucald"),
    0xF190: Identifier("VIN", _vin),
    0xF195: Identifier("software version", lambda s: s.identity.version.encode("utf-8")),
    0xFD00: Identifier("mount angles", _angles),
    0xFD01: Identifier("mount deviations", _deviations),
    0xFD02: Identifier("mount quaternion", _quaternion),
    0xFD03: Identifier("calibration state", _state),
    0xFD04: Identifier("quality", lambda s: bytes([s.quality])),
    0xFD05: Identifier("waiting reasons", _waiting),
    0xFD06: Identifier("configuration identity", lambda s: s.identity.configuration),
    0xFD07: Identifier("vehicle identity", lambda s: encodable(s.identity.vehicle).encode()),
    0xFD08: Identifier("frame counters", _counters),
    0xFD09: Identifier("rejections by reason", _faults),
    0xFD0A: Identifier("uptime", lambda s: u32(int(s.uptime))),
}
"""The server adds the active session (0xF186) and its own counters (0xFD0B)."""


class ReadData:
    """Service 0x22. own: identifiers whose data the server itself provides."""

    def __init__(self, host: Host, own: Mapping[int, Identifier]) -> None:
        self._host = host
        self._identifiers = {**IDENTIFIERS, **own}

    def answer(self, data: bytes) -> Answer:
        """Answer a request for one or more identifiers. Unknown identifiers are left out."""
        if not data or len(data) % 2:
            return Nrc.INCORRECT_LENGTH
        wanted = [number for (number,) in struct.iter_unpack(">H", data)]
        if len(wanted) > MAX_IDENTIFIERS:
            return Nrc.INCORRECT_LENGTH
        found = b"".join(self._records(wanted))
        if not found:
            return Nrc.OUT_OF_RANGE
        return found if len(found) < MAX_RESPONSE else Nrc.RESPONSE_TOO_LONG

    def _records(self, wanted: Sequence[int]) -> list[bytes]:
        records = []
        for number in wanted:
            identifier = self._identifiers.get(number)
            content = None if identifier is None else identifier.read(self._host)
            if content is not None:
                records.append(struct.pack(">H", number) + content)
        return records
