"""Read a DBC or a KCD with damaged parts: only the message or signal of such a part is left out.

Removed text is replaced with spaces, so that all other lines keep their numbers.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator
from xml.parsers import expat

from msgspec import Struct

from imucald.can.columns import CAN_EFF_FLAG, CAN_EFF_MASK, CAN_SFF_MASK
from imucald.can.dbc.message import Message

_STATEMENT = re.compile(
    r"^[ \t]*(VERSION|NS_|BS_|BU_|BO_|SG_|CM_|VAL_TABLE_|VAL_|BA_DEF_DEF_REL_|BA_DEF_REL_|BA_REL_"
    r"|BA_DEF_DEF_|BA_DEF_|BA_SGTYPE_|BA_|SIG_VALTYPE_|SIG_GROUP_|SIG_TYPE_REF_|SG_MUL_VAL_"
    r"|SGTYPE_VAL_|SGTYPE_|BO_TX_BU_|EV_DATA_|ENVVAR_DATA_|EV_)(?![A-Za-z0-9_])",
    re.MULTILINE,
)
_TEXT = re.compile(r'"(?:\\.|[^"\\])*+("?)')
"""Pattern of quoted text, or of all text after a quote without an end. No character is read twice.
"""
_MESSAGE = re.compile(r"BO_\s+(\S+)\s+([^\s:]*)\s*:\s*(\d*)")
_SIGNAL = re.compile(r"SG_\s+([^\s:]+)(?:[ \t]+(M|m\d+M?)\b)?")
_UNREADABLE = "this line cannot be read as DBC; write it like the lines around it"
_DECISIVE = frozenset({"SIG_VALTYPE_", "SG_MUL_VAL_"})
"""Keywords of statements that must not be removed, because a signal would be decoded wrongly
without them. A database is refused if one of these statements is damaged."""
_NAME = re.compile(r"[A-Za-z_]\w*", re.ASCII)
_MULTIPLEXING = re.compile(
    r"^[ \t]*(?:BO_[ \t]+\d+[ \t]+(\w+)|SG_[ \t]+(\w+)[ \t]+m\d+M?[ \t]*:)", re.MULTILINE
)


class LeftOut(Struct, frozen=True):
    """A message or signal that was left out or changed. `why`: the reason and the remedy."""

    message: str
    signal: str
    can_id: int
    length: int
    line: int
    why: str


class _Statement(Struct, frozen=True):
    keyword: str
    start: int
    end: int


class MendedText:
    """The text of a DBC from which damaged lines are removed. left_out: the removed items."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.left_out: list[LeftOut] = []
        self._bad: list[tuple[int, int]] = []
        self._is_scanned = False
        # all attempts together parse so many characters: about 20 s on a slow processor
        self._attempts = min(40, max(3, 2_000_000 // max(1, len(text))))

    def mend(self, reason: str) -> bool:
        """Remove statements that are wrong, and the statement at which the parser stopped.

        Returns False if nothing was found or the limit of attempts is reached.
        """
        if self._attempts == 0:
            return False
        self._attempts -= 1
        before = self.text
        if not self._is_scanned:
            self._is_scanned = True
            self._bad_messages()
            self._blank(*self._bad)
        position = re.search(r"Invalid syntax at line (\d+), column (\d+)", reason)
        if self.text == before and position:
            self._bad = []
            self._at(int(position.group(1)), int(position.group(2)))
            self._blank(*self._bad)
        if self.text != before or not position:
            self._stale()
        return self.text != before

    def _bad_messages(self) -> None:
        """Remove messages with an impossible identifier or an invalid name."""
        statements = list(_statements(self.text))
        for k, one in enumerate(statements):
            found = _MESSAGE.match(self._of(one))
            if one.keyword == "BO_" and found:
                number = int(found.group(1)) if found.group(1).isdecimal() else 0
                why = _id_reason(number) or _name_reason(found.group(2))
                if why:
                    self._take_message(statements, k, why)
            signal = _SIGNAL.match(self._of(one))
            if one.keyword == "SG_" and signal and _name_reason(signal.group(1)):
                self._take_signal(statements, k, _name_reason(signal.group(1)))

    def _at(self, line: int, column: int) -> None:
        """Remove the statement at which the parser stopped, or an unfinished one before it."""
        at = 0
        for _ in range(line - 1):
            at = self.text.find("\n", at) + 1
        at += column - 1
        statements = list(_statements(self.text))
        starts = [one.start for one in statements]
        k = bisect_right(starts, at) - 1
        line_start = at - column + 1
        is_stray = k < 0 or (statements[k].keyword in {"BO_", "SG_"} and starts[k] < line_start)
        if is_stray:  # the next signals may belong to it, not to the message before
            end = k + 1
            while end < len(statements) and statements[end].keyword == "SG_":
                end += 1
            line_end = self.text.find("\n", at)
            until = len(self.text) if line_end < 0 else line_end
            if end > k + 1:
                self._note("", "", 0, 0, at, _UNREADABLE)
                until = statements[end - 1].end
            self._bad.append((line_start, until))
            return
        if starts[k] == at and k and self._is_unfinished(statements[k - 1], statements[k]):
            k -= 1
        one = statements[k]
        if one.keyword == "BO_":
            self._take_message(statements, k, _UNREADABLE)
        elif one.keyword == "SG_":
            self._take_signal(statements, k, _UNREADABLE)
        elif one.keyword not in _DECISIVE:
            self._bad.append((one.start, one.end))

    def _is_unfinished(self, one: _Statement, following: _Statement) -> bool:
        """True if the parser stopped because statement `one` is unfinished, and not because the
        keyword after it is wrong."""
        if one.keyword in {"BO_", "SG_"}:
            return True
        if following.keyword == "SG_" or one.keyword in {"BU_", "BS_", "NS_", "VERSION"}:
            return False
        return not self._of(one).rstrip().endswith(";")

    def _stale(self) -> None:
        """Remove value tables and float types of missing signals, and undefined attributes."""
        known: set[tuple[str, str]] = set()
        number = ""
        stale: list[_Statement] = []
        statements = list(_statements(self.text))
        attributes = set()
        for one in statements:
            if one.keyword == "BO_" and (found := _MESSAGE.match(self._of(one))):
                number = found.group(1)
            elif one.keyword == "SG_" and (signal := _SIGNAL.match(self._of(one))):
                known.add((number, signal.group(1)))
            elif one.keyword == "BA_DEF_" and (
                defined := re.match(r'BA_DEF_\s+(?:[A-Z]+_\s+)?"([^"]*)"', self._of(one))
            ):
                attributes.add(defined.group(1))
        for one in statements:
            if one.keyword in {"VAL_", "SIG_VALTYPE_"}:
                found = re.match(r"(?:VAL_|SIG_VALTYPE_)\s+(\d+)\s+([^\s:]+)", self._of(one))
                if found and found.groups() not in known:
                    stale.append(one)
            elif one.keyword == "BA_":
                found = re.match(r'BA_\s+"([^"]*)"', self._of(one))
                if found and found.group(1) not in attributes:
                    stale.append(one)
        self._blank(*((one.start, one.end) for one in stale))

    def _take_message(self, statements: list[_Statement], k: int, why: str) -> None:
        found = _MESSAGE.match(self._of(statements[k]))
        end = k + 1
        while end < len(statements) and statements[end].keyword == "SG_":
            end += 1
        if not found:
            self._note("", "", 0, 0, statements[k].start, why)
        else:
            number = int(found.group(1)) if found.group(1).isdecimal() else 0
            length = int(found.group(3)) if 0 < len(found.group(3)) < 6 else 0
            can_id = number & (CAN_EFF_MASK | CAN_EFF_FLAG)
            if can_id > CAN_SFF_MASK:
                can_id |= CAN_EFF_FLAG
            self._note(found.group(2), "", can_id, length, statements[k].start, why)
        self._bad.append((statements[k].start, statements[end - 1].end))

    def _take_signal(self, statements: list[_Statement], k: int, why: str) -> None:
        signal = _SIGNAL.match(self._of(statements[k]))
        before = k
        while before > 0 and statements[before].keyword != "BO_":
            before -= 1
        found = _MESSAGE.match(self._of(statements[before]))
        if signal and found:
            why = f"is left out: {why}"
            self._note(found.group(2), signal.group(1), 0, 0, statements[k].start, why)
        self._bad.append((statements[k].start, statements[k].end))
        if signal and found:
            self._take_multiplexed(statements, before, found.group(2), statements[k])

    def _take_multiplexed(
        self, statements: list[_Statement], k: int, message: str, bad: _Statement
    ) -> None:
        """Remove the multiplexed signals of message k if the bad signal may be its multiplexer.

        Without the multiplexer, it is not known which frames contain these signals.
        """
        multiplexed: list[tuple[_Statement, str]] = []
        for one in statements[k + 1 :]:
            if one.keyword != "SG_":
                break
            signal = _SIGNAL.match(self._of(one))
            mark = signal and signal.group(2)
            if not signal or not mark:
                continue
            if one is not bad and mark == "M":
                return
            if one is not bad:
                multiplexed.append((one, signal.group(1)))
        for one, name in multiplexed:
            self._note(
                message,
                name,
                0,
                0,
                one.start,
                "is not used, since the line of its multiplexer cannot be read; correct that line",
            )
            self._bad.append((one.start, one.end))

    def _note(self, message: str, signal: str, can_id: int, length: int, at: int, why: str) -> None:
        line = self.text.count("\n", 0, at) + 1
        message = message or f"(line {line})"
        self.left_out.append(LeftOut(message, signal, can_id, length, line, why))

    def _of(self, one: _Statement) -> str:
        return self.text[one.start : one.end]

    def _blank(self, *ranges: tuple[int, int]) -> None:
        """Replace ranges (start, end) of the text with spaces. The ranges may overlap."""
        parts, at = [], 0
        for start, end in sorted(ranges):
            parts.append(self.text[at:start])
            parts.append(re.sub(r"[^\n]", " ", self.text[max(start, at) : end]))
            at = max(at, end)
        self.text = "".join(parts) + self.text[at:]


def lost_multiplexers(text: str, messages: Iterable[Message]) -> Iterator[LeftOut]:
    """Find signals that are marked as multiplexed but have no multiplexer."""
    always = {m.name: {s.name for s in m.signals.values() if not s.selectors} for m in messages}
    message, line, at = "", 1, 0
    for found in _MULTIPLEXING.finditer(text):
        line, at = line + text.count("\n", at, found.start()), found.start()
        message = found.group(1) or message
        if found.group(2) in always.get(message, ()):
            why = (
                "is multiplexed, but its message has no multiplexer, or it has several and "
                "no SG_MUL_VAL_ for this signal. The signal is read from every frame; mark "
                "one signal as multiplexer with M"
            )
            yield LeftOut(message, found.group(2), 0, 0, line, why)


def _statements(text: str) -> Iterator[_Statement]:
    """Find all statements of a text. Keywords within quoted text are ignored."""
    plain = _TEXT.sub(
        lambda found: re.sub(r"[^\n]", "x", found.group()) if found.group(1) else found.group(),
        text,
    )
    found = list(_STATEMENT.finditer(plain))
    for k, one in enumerate(found):
        end = found[k + 1].start() if k + 1 < len(found) else len(text)
        start = one.start(1)
        yield _Statement(one.group(1), start, start + len(text[start:end].rstrip()))


def _id_reason(number: int) -> str:
    """Return why an identifier is impossible, and the remedy; empty if it is possible."""
    bits = number & ~CAN_EFF_FLAG
    if number <= CAN_SFF_MASK or (number & CAN_EFF_FLAG and bits <= CAN_EFF_MASK):
        return ""
    if number <= CAN_EFF_MASK:
        return (
            f"identifier {number} (0x{number:X}) has more than 11 bits, but is not marked as "
            f"a 29-bit identifier; add {CAN_EFF_FLAG} to it: {number + CAN_EFF_FLAG}"
        )
    if bits == 0x4000_0000:  # VECTOR__INDEPENDENT_SIG_MSG
        return ""
    return (
        f"identifier {number} (0x{number:X}) has more than 29 bits; write the identifier that "
        "is sent"
    )


def _name_reason(name: str) -> str:
    if _NAME.fullmatch(name):
        return ""
    return (
        f"{name!r} is not a valid name: a name begins with a letter and contains letters, "
        "digits and _; rename it"
    )


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
        alone = (
            '<NetworkDefinition xmlns="http://kayak.2codeornot2code.org/1.0"><Bus name="">%s</Bus>'
            "</NetworkDefinition>"
        )
        data = self.text.encode()
        parts, at, count = [], 0, len(self.left_out)
        for one in _messages(data):
            text = data[one.start : one.end]
            reason = self._reason_of(alone % text.decode())
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
