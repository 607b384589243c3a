"""Captures of Wireshark and tcpdump (PCAP, PCAPNG) of a CAN interface, through dpkt.

Link types: LINKTYPE_CAN_SOCKETCAN (one interface) and LINKTYPE_LINUX_SLL, SLL2 ("any"). A packet
contains Linux's struct canfd_frame with the id in network byte order (tcpdump.org/linktypes). Some
programs write the id in little-endian order. The reader tests which of the two orders gives valid
ids in the first packets.
"""

from __future__ import annotations

import itertools
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO, ClassVar, Final

from imucald.can.columns import (
    CAN_EFF_FLAG,
    CAN_EFF_MASK,
    CAN_ERR_FLAG,
    CAN_RTR_FLAG,
    CAN_SFF_MASK,
    CANFD_FDF,
    CLASSIC_BYTES,
    FD_BYTES,
    Channels,
    FrameColumns,
)
from imucald.can.id_filter import IdFilters
from imucald.can.logs.frame_batches import FrameBatches
from imucald.can.logs.log_format import ReadStatistics
from imucald.can.logs.text_blocks import OpenLog
from imucald.can.logs.unpacking import InPieces, plain_file
from imucald.core.errors import LogError
from imucald.core.libraries import how_to_install

_PCAPNG: Final = b"\x0a\x0d\x0d\x0a"
_PCAP: Final = (
    b"\xd4\xc3\xb2\xa1", b"\xa1\xb2\xc3\xd4", b"\x4d\x3c\xb2\xa1", b"\xa1\xb2\x3c\x4d",
)  # fmt: skip
SOCKETCAN, SLL, SLL2 = 227, 113, 276
_CAN_PROTOCOLS: Final = (0x000C, 0x000D)
"""Protocol numbers of classic CAN and CAN FD in a cooked capture (linux/if_ether.h)."""
OTHER_LINKS: Final = {
    1: "Ethernet",
    101: "IP",
    105: "WLAN",
    189: "USB",
    210: "FlexRay",
    211: "MOST",
    212: "LIN",
    220: "USB",
}
"""Names of other link types, for error texts (tcpdump.org/linktypes)."""


class PcapReader:
    """Reads captures into columns."""

    endings: ClassVar[tuple[str, ...]] = (".pcap", ".pcapng")

    @staticmethod
    def begins(head: bytes) -> bool:
        """True if the first four bytes are the signature of a capture file."""
        return head[:4] == _PCAPNG or head[:4] in _PCAP

    def __init__(self, filters: IdFilters, channels: Channels, statistics: ReadStatistics) -> None:
        self._statistics = statistics
        self._batches = FrameBatches(filters, channels, statistics)

    def read(
        self, path: Path | str | OpenLog, report: Callable[[int], None]
    ) -> Iterator[FrameColumns]:
        """Yield the wanted frames of one file in batches, see `LogFormat.read`."""
        if isinstance(path, OpenLog):
            raise LogError(f"{path}: this format is read from a file by its name, not from a pipe")
        with plain_file(Path(path)) as (plain, damage), plain.open("rb") as file:
            yield from self._frames(file, str(path), report)
            if damage:
                self._statistics.reject("damaged_file", f"{path}: reading ends here: {damage}")
        yield self._batches.columns()

    def _frames(
        self, file: BinaryIO, name: str, report: Callable[[int], None]
    ) -> Iterator[FrameColumns]:
        number = 0
        try:
            reader = _opened(file, name)
            packets = iter(reader)
            first = list(itertools.islice(packets, 64))
            order = _order_of_ids([packet for _, packet in first], reader.datalink())
            if order == "<":
                self._statistics.note(
                    f"{name}: its ids were stored in little-endian byte order; this was corrected"
                )
            for number, (t, packet) in enumerate(itertools.chain(first, packets), 1):
                reason = self._packet(float(t), packet, reader.datalink(), order)
                if reason:
                    self._statistics.reject(reason, f"{name}: packet {number}: {reason}")
                if self._batches.is_full:
                    report(file.tell())
                    yield self._batches.columns()
        except LogError:
            raise
        # for damaged captures, dpkt raises its own errors, struct's and ValueError
        except Exception as error:
            text = f"{name}: cannot be read: {error or type(error).__name__}"
            if not number:
                raise LogError(text) from error
            self._statistics.reject("cut_file", f"{name}: the file is cut after {number} packets")
            return

    def _packet(self, t: float, packet: bytes, link: int, order: str) -> str:
        protocol, packet = _unwrapped(packet, link)
        if protocol not in _CAN_PROTOCOLS:
            self._statistics.ignore("other_protocol")
            return ""
        if len(packet) < 8:
            return "bad_length"
        word, length, marks = struct.unpack(f"{order}IBB", packet[:6])
        if word & CAN_ERR_FLAG:
            self._statistics.ignore("error_frame")
            return ""
        if word & CAN_RTR_FLAG:
            self._statistics.ignore("remote_frame")
            return ""
        fd = bool(marks & CANFD_FDF) or protocol == _CAN_PROTOCOLS[1] or length > CLASSIC_BYTES
        data = packet[8 : 8 + length]
        if len(data) != length or length > FD_BYTES:
            return "bad_length"
        if not _is_id(word):
            return "bad_id"
        mask = CAN_EFF_MASK if word & CAN_EFF_FLAG else CAN_SFF_MASK
        can_id = word & mask | word & CAN_EFF_FLAG
        return "" if self._batches.add_frame(t, can_id, data, "can0", fd) else "too_many_channels"


def _unwrapped(packet: bytes, link: int) -> tuple[int, bytes]:
    if link == SLL:
        return int.from_bytes(packet[14:16], "big"), packet[16:]
    if link == SLL2:
        return int.from_bytes(packet[0:2], "big"), packet[20:]
    return _CAN_PROTOCOLS[0], packet


def _is_id(word: int) -> bool:
    """True if a word can be an id with flags. Without the 29-bit flag it must fit 11 bits."""
    return bool(word & (CAN_EFF_FLAG | CAN_ERR_FLAG)) or word & CAN_EFF_MASK <= CAN_SFF_MASK


def _order_of_ids(packets: list[bytes], link: int) -> str:
    """Return the byte order (of struct) that gives more valid ids; network order if equal."""
    frames = [
        frame
        for protocol, frame in (_unwrapped(p, link) for p in packets)
        if protocol in _CAN_PROTOCOLS
    ]
    votes = {
        order: sum(_is_id(struct.unpack(f"{order}I", f[:4])[0]) for f in frames if len(f) >= 4)
        for order in "><"
    }
    return "<" if votes["<"] > votes[">"] else ">"


def _opened(file: BinaryIO, name: str) -> Any:
    try:
        import dpkt  # noqa: PLC0415 - an extra
    except ImportError:
        text = f"reading captures needs the package dpkt: {how_to_install('logs')}"
        raise LogError(f"{name}: {text}") from None
    magic = file.read(4)
    file.seek(0)
    reader = (dpkt.pcapng.Reader if magic == _PCAPNG else dpkt.pcap.Reader)(InPieces(file))
    if (link := reader.datalink()) not in (SOCKETCAN, SLL, SLL2):
        kind = (
            f"{OTHER_LINKS[link]} (link type {link})"
            if link in OTHER_LINKS
            else f"link type {link}"
        )
        raise LogError(
            f"{name}: this is a capture of {kind}, not of a CAN interface; capture with: "
            "dumpcap -i can0"
        )
    return reader


FORMAT = PcapReader
