"""Read a KCD with damaged messages: only these messages are left out.

Removed text is replaced with spaces, so that all other lines keep their numbers.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from xml.parsers import expat

from msgspec import Struct

from imucald.can.columns import CAN_EFF_FLAG, CAN_EFF_MASK, CAN_SFF_MASK
from imucald.can.dbc.dbc_mending import LeftOut

_NAMESPACE = "http://kayak.2codeornot2code.org/1.0"
_ALONE = f'<NetworkDefinition xmlns="{_NAMESPACE}"><Bus name="">%s</Bus></NetworkDefinition>'
"""Template of a database with one message."""


class _Element(Struct, frozen=True):
    """A message: attributes, line, and its position in the UTF-8 text."""

    attributes: dict[str, str]
    line: int
    start: int
    end: int


class MendedKcd:
    """The text of a KCD without the messages that cannot be read. left_out: these messages.

    reason_of: returns why a text cannot be read; empty if it can be read.
    """

    def __init__(self, text: str, reason_of: Callable[[str], str]) -> None:
        self.text = text
        self.left_out: list[LeftOut] = []
        self._reason_of = reason_of

    def mend(self, _reason: str) -> bool:
        """Remove every message that cannot be read even without the other messages. Return False if
        there is none."""
        data = self.text.encode()
        parts, at, count = [], 0, len(self.left_out)
        for one in _messages(data):
            text = data[one.start : one.end]
            reason = self._reason_of(_ALONE % text.decode())
            if reason:
                self.left_out.append(_left_out(one, reason))
                parts += [data[at : one.start], re.sub(rb"[^\n]", b" ", text)]
                at = one.end
        self.text = b"".join([*parts, data[at:]]).decode()
        return len(self.left_out) > count


def _messages(data: bytes) -> list[_Element]:
    """Find all elements named Message. Empty if the text is not valid XML."""
    found: list[_Element] = []
    begun: list[tuple[dict[str, str], int, int]] = []
    parser = expat.ParserCreate("utf-8")

    def start(name: str, attributes: dict[str, str]) -> None:
        if name == "Message":
            begun.append((attributes, parser.CurrentLineNumber, parser.CurrentByteIndex))

    def end(name: str) -> None:
        if name == "Message" and begun:
            attributes, line, at = begun.pop()
            close = parser.CurrentByteIndex  # an element of one tag: its end
            if data.startswith(b"</", close):
                close = data.index(b">", close) + 1
            if not begun:  # a nested message is part of the outer one
                found.append(_Element(attributes, line, at, close))

    parser.StartElementHandler, parser.EndElementHandler = start, end
    try:
        parser.Parse(data, True)
    except expat.ExpatError:
        return []
    return found


def _left_out(one: _Element, reason: str) -> LeftOut:
    number = _number(one.attributes.get("id", ""))
    length = _number(one.attributes.get("length", ""))
    is_extended = one.attributes.get("format") == "extended"
    if CAN_SFF_MASK < number <= CAN_EFF_MASK and not is_extended:
        reason = (
            f"identifier 0x{number:X} is longer than 11 bits, but not marked as 29 bits; "
            'add format="extended" to it'
        )
        is_extended = True
    can_id = number & CAN_EFF_MASK | (CAN_EFF_FLAG if is_extended else 0)
    name = one.attributes.get("name") or f"(line {one.line})"
    return LeftOut(name, "", can_id, length, one.line, reason)


def _number(text: str) -> int:
    """Convert an integer in the notation of KCD; 0 for anything else."""
    try:
        return max(0, int(text, 0))
    except ValueError:
        return 0
