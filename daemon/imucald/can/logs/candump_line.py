"""Parse one line of a candump log strictly, and give a reason for each rejected line.

The grammar is the output format of ``candump -L`` (can-utils, lib.c and candump.c)::

    (1600000000.000000) can0 200#1300E1FF2B130000       classic frame, 0 to 8 bytes
    (1600000000.000000) can0 18FEF100#11223344          29-bit id: always eight digits
    (1600000000.000000) can0 200##1AABBCC               CAN FD: flags digit, 0 to 64 bytes
    (1600000000.000000) can0 200#R4                     remote frame
    (1600000000.000000)  can0 20000080#0000000000000000 error frame (id bit 29)

The following variants are accepted: any number of digits before and after the point, spaces that
align channels, ``_9`` .. ``_F`` (raw length code) after eight bytes, a final `` R`` or `` T``
(received, sent), CR LF line ends, hexadecimal digits in upper and lower case. Also accepted are
tabs between the fields (other programs) and blanks before the seconds (old versions of candump).
"""

from __future__ import annotations

import re
from typing import Final, NamedTuple

from imucald.can.columns import CAN_EFF_FLAG

MAX_LINE_BYTES: Final = 4096
"""Longest line [bytes]. A real line has at most about 220 bytes (except CAN XL)."""

REASONS: Final[dict[str, str]] = {
    "cut_line": "the line is cut",
    "not_candump": "not a line of candump -L: it must begin with (seconds.fraction)",
    "bad_timestamp": "the time stamp is not (seconds.fraction)",
    "negative_timestamp": "the time stamp is negative: add the same time to all stamps",
    "no_channel": "the channel is missing",
    "bad_channel": "the channel is not a name of 1 to 32 printable characters",
    "bad_id": "the id is not 3 digits up to 7FF or 8 digits up to 3FFFFFFF",
    "bad_hex": "the data contains a character that is not a hexadecimal digit",
    "odd_digits": "the data has an odd number of digits",
    "too_long": "the data is longer than a frame can be",
    "bad_frame": "the frame is not ID#DATA",
    "trailing_text": "text behind the frame",
    "nul_bytes": "the line holds NUL bytes",
    "line_too_long": f"the line is longer than {MAX_LINE_BYTES} bytes",
    "too_many_channels": "more than 255 channels",
}
"""All reasons for rejecting a line, with their texts."""

_LINE = re.compile(
    rb"""\((?P<pad>[ \t]{0,32})(?P<t>[0-9]{1,19}\.[0-9]{1,19})\)
    (?P<gap>[ \t]{1,32})(?P<channel>[!"$-~]{1,32})(?P<mid>[ ]|[ \t]{1,32})
    (?:
      (?P<id>[0-7][0-9A-Fa-f]{2}|[01][0-9A-Fa-f]{7})
      (?:
        \#(?P<data>(?:[0-9A-Fa-f]{2}){0,7}|(?:[0-9A-Fa-f]{2}){8}(?:_[9A-Fa-f])?)
        |\#\#[0-9A-Fa-f](?P<fd>(?:[0-9A-Fa-f]{2}){0,64})
        |(?P<remote>\#[Rr](?:[0-7]|8(?:_[9A-Fa-f])?)?)
      )
      |(?P<error>[23][0-9A-Fa-f]{7}\#(?:[0-9A-Fa-f]{2}){0,8})
      |(?:[0-9A-Fa-f]{5}\#[0-9A-Fa-f]{2}:[0-9A-Fa-f]{2}:[0-9A-Fa-f]{8}\#
        (?:[0-9A-Fa-f]{2}){1,2048})
    )
    (?:[ \t][RT])?\r?""",
    re.VERBOSE,
)
_STAMP = re.compile(rb"\([ \t]{0,32}[0-9]{1,19}\.[0-9]{1,19}\)(?=[ \t]|$)")
_CHANNEL = re.compile(rb'[!"$-~]{1,32}')


class Line(NamedTuple):
    """A valid line. kind: data, remote_frame, error_frame or xl_frame. The other fields are set
    only for data."""

    kind: str
    t: float
    channel: str
    can_id: int
    data: bytes
    fd: bool
    is_usual: bool
    """True if the line has the layout of current candump versions."""


def words_of(reason: str) -> str:
    """Return the text for the name of a rejection reason. Reasons of all log formats are
    accepted."""
    return (
        REASONS["negative_timestamp"]
        if reason == "negative_timestamp"
        else reason.replace("_", " ")
    )


def parse_line(text: bytes) -> Line | str | None:
    """Return the frame of one line (without its newline), or the name of the reason.

    Returns None for a blank line, which is not an error.
    """
    if len(text) > MAX_LINE_BYTES:
        return "line_too_long"
    match = _LINE.fullmatch(text)
    if match is None:
        return _reason(text) if text.strip() else None
    pad, t, gap, name, mid, can_id, data, fd, remote, error = match.group(
        "pad", "t", "gap", "channel", "mid", "id", "data", "fd", "remote", "error"
    )
    is_usual = not pad and mid == b" " and b"\t" not in gap
    channel = name.decode("ascii")
    if can_id is None or remote is not None:
        kind = "remote_frame" if remote else "error_frame" if error else "xl_frame"
        return Line(kind, float(t), channel, 0, b"", False, is_usual)
    number = int(can_id, 16) | (CAN_EFF_FLAG if len(can_id) == 8 else 0)
    digits = data.partition(b"_")[0] if fd is None else fd
    payload = bytes.fromhex(digits.decode("ascii"))
    return Line("data", float(t), channel, number, payload, fd is not None, is_usual)


def _reason(text: bytes) -> str:
    if b"\0" in text:
        return "nul_bytes"
    stamp = _STAMP.match(text)
    if stamp is None and re.match(rb"\([ \t]{0,32}-[0-9]+\.[0-9]+\)", text):
        return "negative_timestamp"
    if stamp is None:
        return "bad_timestamp" if text.startswith(b"(") else "not_candump"
    return _field_reason([stamp[0], *text[stamp.end() :].split()])


def _field_reason(fields: list[bytes]) -> str:
    if len(fields) == 1:
        return "cut_line"
    if b"#" in fields[1]:
        return "no_channel"
    if not _CHANNEL.fullmatch(fields[1]):
        return "bad_channel"
    if len(fields) == 2:
        return "cut_line"
    if len(fields) > 4 or (len(fields) == 4 and fields[3] not in (b"R", b"T")):
        return "trailing_text"
    return _frame_reason(fields[2])


def _frame_reason(frame: bytes) -> str:
    can_id, mark, data = frame.partition(b"#")
    if not mark:
        return "cut_line"
    if not re.fullmatch(rb"[0-7][0-9A-Fa-f]{2}|[0-3][0-9A-Fa-f]{7}", can_id):
        return "bad_id"
    most = 16
    if data.startswith(b"#"):
        data, most = data[2:], 128
    if not re.fullmatch(rb"[0-9A-Fa-f]*", data):
        return "bad_hex"
    if len(data) > most:
        return "too_long"
    return "odd_digits" if len(data) % 2 else "bad_frame"


def shown(text: bytes) -> str:
    """Return a short, printable form of a line for messages."""
    return repr(text[:60])[2:-1] + ("..." if len(text) > 60 else "")
