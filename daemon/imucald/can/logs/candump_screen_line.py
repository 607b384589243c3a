"""Parse one line of candump's screen output strictly; give a reason for each rejected line."""

from __future__ import annotations

import re
from typing import Final, NamedTuple

from imucald.can.columns import CAN_EFF_FLAG, CAN_SFF_MASK, CLASSIC_BYTES, FD_BYTES
from imucald.can.logs.candump_line import REASONS, Line, parse_line

ERROR_ID: Final = 0x2000_0000
"""Printed ids of 8 digits from this value on are error frames."""

PRINTED: Final = re.compile(
    rb"""[ ]*(?:\((?P<stamp>[0-9][0-9 .:-]{4,30})\)[ ]+)?
    (?P<channel>[!"$-~]{1,32})[ ]+
    (?:[RT]X[ ][B-][ ][E-][ ]+)?
    (?P<id>[0-9A-F]{3}|[0-9A-F]{8})[ ]+\[(?P<length>[0-9]{1,2})\](?P<rest>(?:[ ].*)?)""",
    re.VERBOSE,
)
AS_CANSEND: Final = re.compile(rb"\s*[0-9A-Fa-f]{3,8}#(?:#?[0-9A-Fa-f]|R|\s|$)")


class ScreenFrame(NamedTuple):
    """One frame; can_id with the flag for 29 bits."""

    can_id: int
    data: bytes
    channel: str
    fd: bool


class LineFault(NamedTuple):
    """Why a line cannot be used: the name of the reason, and its text."""

    reason: str
    text: str


def frame_of_line(line: bytes, match: re.Match[bytes] | None) -> ScreenFrame | LineFault | str:
    """Return the frame of a line, or the reason why it has none, or the kind of a frame without
    data.

    match: match of the line with the pattern `PRINTED`; None if the line does not have candump's
    form.
    """
    return _as_cansend(line) if match is None else _as_printed(match)


def _as_printed(match: re.Match[bytes]) -> ScreenFrame | LineFault | str:
    channel, id_text, length_text, rest = match.group("channel", "id", "length", "rest")
    can_id, length, rest = int(id_text, 16), int(length_text), rest.strip()
    is_extended = len(id_text) == 8
    if rest.startswith(b"remote request"):
        return "remote_frame"
    if is_extended and can_id >= ERROR_ID:
        return "error_frame"
    data = _data(rest, length)
    fd = len(length_text) == 2
    if data is None or length > (FD_BYTES if fd else CLASSIC_BYTES):
        return LineFault("bad_hex", f"the line does not have {length} data bytes")
    if not is_extended and can_id > CAN_SFF_MASK:
        return LineFault("bad_id", "the id is not 3 digits up to 7FF")
    can_id |= CAN_EFF_FLAG if is_extended else 0
    return ScreenFrame(can_id, data, channel.decode("ascii"), fd)


def _as_cansend(line: bytes) -> ScreenFrame | LineFault | str:
    if not AS_CANSEND.match(line):
        return LineFault("not_candump", "not a line that candump prints")
    parsed = parse_line(b"(0.0) can0 " + line.strip())
    if isinstance(parsed, Line):
        if parsed.kind != "data":
            return parsed.kind
        return ScreenFrame(parsed.can_id, parsed.data, "can0", parsed.fd)
    return LineFault(parsed or "not_candump", REASONS[parsed or "not_candump"])


def _data(rest: bytes, length: int) -> bytes | None:
    """Return the bytes of a frame, printed in one of four forms; None if the number of bytes is
    wrong."""
    if not length:
        return b""
    end = 3 * length - 1
    if rest[2:end:3] == b" " * (length - 1) and rest[end : end + 1] in b" ":  # the usual form
        try:
            data = bytes.fromhex(rest[:end].decode("ascii"))
        except ValueError:
            return None
        if len(data) == length:
            return data
    reverse = b"`" in rest[:3] or b"`" in rest[:9]
    words = rest.partition(b"   ")[0].split(b"`" if reverse else None)[:length]
    if len(words) != length:
        return None
    base = 2 if len(words[0]) == 8 else 16
    try:
        if any(len(w) != (8 if base == 2 else 2) for w in words):
            return None
        data = bytes(int(w, base) for w in words)
    except ValueError:
        return None
    return data[::-1] if reverse else data
