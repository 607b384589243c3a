"""Texts for people: numbers with nouns, times, and external texts made safe for a screen.

A terminal executes control characters, and characters that change the writing direction can hide
the content of a text. Each such character is shown as a JSON escape (``\\u001b``), so that JSON
keeps its meaning.

A file name consists of bytes. Bytes that are not UTF-8 are stored by Python as lone surrogates. No
encoder accepts lone surrogates. A text that may contain a file name is therefore made encodable
before it is sent or written.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping
from typing import Any, Final, TextIO

_SURROGATES: Final = "\ud800-\udfff"
"""Characters that represent bytes of a file name that are not UTF-8. These characters cannot be
encoded."""
CONTROLS: Final = re.compile(f"[\x00-\x08\x0b\x0c\x0e-\x1f{_SURROGATES}]|\r(?!\n)")
"""Unsafe characters for files and pipes: the characters that JSON always escapes."""
UNSAFE: Final = re.compile(
    "[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069"
    f"{_SURROGATES}]|\r(?!\n)"
)
"""Unsafe characters for screens and logs. Line breaks and tabs are not unsafe."""
_LINE_BREAKING: Final = re.compile(f"{UNSAFE.pattern}|[\n\t\r]")


def made_safe(text: str, unsafe: re.Pattern[str] = UNSAFE) -> str:
    """Return the text with its unsafe characters as escapes."""
    return unsafe.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def one_line(text: str) -> str:
    """Return the text as one line, for a table cell or a sentence: unsafe characters and line
    breaks are escaped."""
    return made_safe(text, _LINE_BREAKING)


def without_numbers(text: str) -> str:
    """Return the text without its numbers. The results are equal for texts that differ only in
    numbers."""
    return re.sub(r"[0-9.]+", "", text)


class SafeStream:
    """A text stream that writes unsafe characters as escapes. Other text is not changed."""

    def __init__(self, behind: TextIO, is_for_people: bool = False) -> None:
        """behind: the underlying stream. is_for_people: escape all characters of `UNSAFE`, also if
        the stream is not a terminal (as for standard error)."""
        self.behind = behind
        """The underlying stream without escapes, for our own control characters."""
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
    """Return the underlying stream, which accepts control characters."""
    return stream.behind if isinstance(stream, SafeStream) else stream


def counted(n: int, one: str, many: str = "") -> str:
    """Return a number with its noun, such as `1 stop` or `2 stops`. many: the plural if it is not
    `one` with an s."""
    return f"{n} {one if n == 1 else many or one + 's'}"


def clock(seconds: float) -> str:
    """Return a time as minutes and seconds (`4:02`), with hours if there are any. Fractions of a
    second are cut.
    """
    minutes, rest = divmod(int(max(seconds, 0.0) + 1e-6), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def when_reached(name: str, seconds: float) -> str:
    """Return a text that states when a state was reached: `usable after 4:02`, or that the state
    was reached from the start.
    """
    return f"{name} after {clock(seconds)}" if seconds >= 1.0 else f"{name} from the start"


def reached_states(result: Mapping[str, Any], lead: float = 0.0) -> list[str]:
    """Return when a result or status says that *usable* and *fine* were reached. lead: time [s] to
    subtract."""
    times = {name: result[f"first_{name}_s"] for name in ("usable", "fine")}
    return [when_reached(name, t - lead) for name, t in times.items() if t is not None]


def duration(seconds: float) -> str:
    """Return a duration as text: `45 s`, `31 min` or `2.3 h`."""
    if not math.isfinite(seconds):
        return "-"
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200.0 else f"{seconds / 3600:.1f} h"


def size(count: float) -> str:
    """Return a number of bytes as text: `72.8 MB` or `12.3 GB`."""
    return f"{count / 1e9:.3g} GB" if count >= 1e9 else f"{count / 1e6:.3g} MB"


_LONE = re.compile(f"[{_SURROGATES}]")


def encodable(text: str) -> str:
    r"""Return the text with each lone surrogate as the letters ``\udcff``; never fails."""
    return _LONE.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def json_text(content: Any, indent: int | None = None) -> str:
    r"""Return JSON that can be encoded as UTF-8. Raises ValueError for NaN and infinity.

    A lone surrogate is replaced by the letters ``\udcff`` within its string. A lone surrogate is
    not written as a JSON escape (``"\udcff"``), because strict readers refuse such an escape, and
    other readers cannot print the result.
    """
    text = json.dumps(content, indent=indent, allow_nan=False, ensure_ascii=False)
    return _LONE.sub(lambda found: f"\\\\u{ord(found[0]):04x}", text)
