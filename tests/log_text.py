"""Candump text written and judged without the code under test."""

from __future__ import annotations

import re
from typing import NamedTuple

from imucald.can.logs.log_reader import CAN_EFF_FLAG, FrameColumns


class Frame(NamedTuple):
    t: float
    can_id: int
    data: bytes
    channel: str
    fd: bool


def frames_of(*chunks: FrameColumns) -> list[Frame]:
    """Return the frames of chunks one by one; checks that padding is zero."""
    frames = []
    for chunk in chunks:
        for k in range(len(chunk.t)):
            length = int(chunk.length[k])
            assert not chunk.data[k, length:].any()
            frames.append(
                Frame(
                    float(chunk.t[k]),
                    int(chunk.can_id[k]),
                    chunk.data[k, :length].tobytes(),
                    chunk.channels[chunk.channel[k]],
                    chunk.fd is not None and bool(chunk.fd[k]),
                )
            )
    return frames


def text_of(stamp: str, frame: Frame, gap: int = 1, tail: str = "", flags: int = 0) -> str:
    """Return one line (no newline) for a frame, its time written as `stamp`."""
    extended = frame.can_id >= CAN_EFF_FLAG
    number = f"{frame.can_id - CAN_EFF_FLAG:08X}" if extended else f"{frame.can_id:03X}"
    mark = f"##{flags:X}" if frame.fd else "#"
    return f"({stamp}){' ' * gap}{frame.channel} {number}{mark}{frame.data.hex().upper()}{tail}"


# The grammar once more, in another form than the reader's: alternatives of whole frames.
_H = "[0-9a-fA-F]"
_ID = f"(?:[0-7]{_H}{_H}|[01]{_H}{{7}})"
_STRICT = re.compile(
    r"\([ \t]{0,32}(?P<stamp>[0-9]{1,19}\.[0-9]{1,19})\)[ \t]{1,32}"
    r"(?P<channel>[!-\"$-~]{1,32})[ \t]{1,32}"
    "(?:"
    f"(?P<classic>{_ID}#(?:{_H}{_H}){{0,8}})"
    f"|(?P<raw>{_ID}#(?:{_H}{_H}){{8}}_[9a-fA-F])"
    f"|(?P<fd>{_ID}##{_H}(?:{_H}{_H}){{0,64}})"
    f"|(?P<remote>{_ID}#[rR](?:[0-8]|8_[9a-fA-F])?)"
    f"|(?P<error>[23]{_H}{{7}}#(?:{_H}{_H}){{0,8}})"
    f"|(?P<xl>{_H}{{5}}#{_H}{_H}:{_H}{_H}:{_H}{{8}}#(?:{_H}{_H}){{1,2048}})"
    r")(?:[ \t][RT])?\r?"
)


def judged(line: bytes) -> Frame | str | None:
    """Return a data frame, the kind of another valid frame, or None for a line that is no good."""
    match = _STRICT.fullmatch(line.decode("latin-1"))
    if match is None or len(line) > 4096:
        return None
    for kind in ("remote", "error", "xl"):
        if match[kind]:
            return kind
    fd = bool(match["fd"])
    number, data = (match["classic"] or match["raw"] or match["fd"]).split("#", 1)
    data = data[2:] if fd else data.split("_")[0]
    can_id = int(number, 16) + (CAN_EFF_FLAG if len(number) == 8 else 0)
    return Frame(float(match["stamp"]), can_id, bytes.fromhex(data), match["channel"], fd)


def without_damaged_stamps(frames: list[Frame]) -> list[Frame]:
    """Frames of a file without those that are 10 s from both neighbours, which are together."""
    t = [frame.t for frame in frames]
    alone = [
        0 < k < len(t) - 1
        and abs(t[k] - t[k - 1]) > 10.0
        and abs(t[k + 1] - t[k]) > 10.0
        and abs(t[k + 1] - t[k - 1]) <= 10.0
        for k in range(len(t))
    ]
    around = [False, *alone, False]
    return [
        frame
        for k, frame in enumerate(frames)
        if not (alone[k] and not around[k] and not around[k + 2])
    ]
