"""Text for people: numbers with their nouns, times, and external text made safe for a screen.

A terminal obeys control characters, and characters that change the direction of writing hide the
content of a text. Each such character is shown as an escape of JSON (``\\u001b``), so that JSON
keeps its meaning.

A file name is bytes. If they are not UTF-8, Python stores them as lone surrogates, which no encoder
accepts. A text that may contain a file name is therefore made encodable before it is sent or
written.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable
from typing import Any, Final, TextIO

_SURROGATES: Final = "\ud800-\udfff"
"""Characters that represent bytes of a name that is not UTF-8: no encoding has them."""
CONTROLS: Final = re.compile(f"[\x00-\x08\x0b\x0c\x0e-\x1f{_SURROGATES}]|\r(?!\n)")
"""Unsafe characters for files and pipes: those that JSON escapes itself."""
UNSAFE: Final = re.compile(
    "[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069"
    f"{_SURROGATES}]|\r(?!\n)"
)
"""Unsafe characters for screens and logs; new lines and tabs are not among them."""
_NUMBERS: Final = re.compile(r"[0-9.]+")
_LINE_BREAKING: Final = re.compile(f"{UNSAFE.pattern}|[\n\t\r]")


def made_safe(text: str, unsafe: re.Pattern[str] = UNSAFE) -> str:
    """Return the text with its unsafe characters as escapes."""
    return unsafe.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def one_line(text: str) -> str:
    """Return the text for a cell of a table or a sentence: line breaks are escaped too."""
    return made_safe(text, _LINE_BREAKING)


def without_numbers(text: str) -> str:
    """Return a text that is the same for texts that differ only in numbers."""
    return _NUMBERS.sub("", text)


class SafeStream:
    """A stream of text with control characters as escapes; other data pass unchanged."""

    def __init__(self, behind: TextIO, is_for_people: bool = False) -> None:
        """is_for_people: escape even if the stream is no terminal, as for standard error."""
        self.behind = behind
        """The stream without escapes, for our own control characters."""
        self._unsafe = UNSAFE if is_for_people or behind.isatty() else CONTROLS

    def write(self, text: str) -> int:
        """Write a text."""
        self.behind.write(made_safe(text, self._unsafe))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write several texts."""
        for line in lines:
            self.write(line)

    def __iter__(self) -> Any:
        return iter(self.behind)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.behind, name)


def stream_behind(stream: Any) -> Any:
    """Return the stream that accepts control characters."""
    return stream.behind if isinstance(stream, SafeStream) else stream


def counted(n: int, one: str, many: str = "") -> str:
    """Return `1 stop`, `2 stops`; many: the plural if it is not `one` with an s."""
    return f"{n} {one if n == 1 else many or one + 's'}"


def clock(seconds: float) -> str:
    """Return `4:02`, with hours if there are any; whole seconds that have passed, as a watch
    shows.
    """
    minutes, rest = divmod(int(max(seconds, 0.0) + 1e-6), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def when_reached(name: str, seconds: float) -> str:
    """Return when a state was reached: `usable after 4:02`; for a mount that was known before, from
    the start.
    """
    return f"{name} after {clock(seconds)}" if seconds >= 1.0 else f"{name} from the start"


def duration(seconds: float) -> str:
    """Return a length of time: `45 s`, `31 min`, `2.3 h`."""
    if not math.isfinite(seconds):
        return "-"
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200.0 else f"{seconds / 3600:.1f} h"


_LONE = re.compile("[\ud800-\udfff]")


def encodable(text: str) -> str:
    r"""Return the text with each lone surrogate as the letters ``\udcff``; never fails."""
    return _LONE.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def json_text(content: Any, indent: int | None = None) -> str:
    r"""Return JSON that UTF-8 can hold. Raises ValueError for NaN and infinity.

    A lone surrogate becomes the letters ``\udcff`` within its string. Strict readers refuse it as a
    JSON escape (``"\udcff"``), and readers that accept that escape cannot print the result.
    """
    text = json.dumps(content, indent=indent, allow_nan=False, ensure_ascii=False)
    return _LONE.sub(lambda found: f"\\\\u{ord(found[0]):04x}", text)
