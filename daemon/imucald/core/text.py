"""Text for people: numbers with their nouns, times, and text from outside made fit for a screen.

A terminal obeys control characters; those that turn the direction of writing hide what a text
says. Each is shown as an escape of JSON (``\\u001b``), so that JSON keeps its meaning.

A file name is bytes; where they are no UTF-8, Python holds them as lone surrogates, which no
encoder takes. So a text that may name a file is made encodable before it is sent or written.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable
from typing import Any, Final, TextIO

_SURROGATES: Final = "\ud800-\udfff"
"""What stands for bytes of a name that is not UTF-8: no encoding has them."""
CONTROLS: Final = re.compile(f"[\x00-\x08\x0b\x0c\x0e-\x1f{_SURROGATES}]|\r(?!\n)")
"""For files and pipes: what JSON escapes itself."""
UNSAFE: Final = re.compile(
    "[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069"
    f"{_SURROGATES}]|\r(?!\n)"
)
"""For screens and logs; new lines and tabs are neither."""
_NUMBERS: Final = re.compile(r"[0-9.]+")
_LINE_BREAKING: Final = re.compile(f"{UNSAFE.pattern}|[\n\t\r]")


def made_safe(text: str, unsafe: re.Pattern[str] = UNSAFE) -> str:
    """The text with its unsafe characters as escapes."""
    return unsafe.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def one_line(text: str) -> str:
    """The text for a cell of a table or a sentence: what would break its line is an escape too."""
    return made_safe(text, _LINE_BREAKING)


def without_numbers(text: str) -> str:
    """Return a text by which two are the same where only numbers differ."""
    return _NUMBERS.sub("", text)


class SafeStream:
    """A stream of text whose control characters are escapes; what is not text goes its own way."""

    def __init__(self, behind: TextIO, is_for_people: bool = False) -> None:
        """is_for_people: also where it is no terminal, as standard error is."""
        self.behind = behind
        """The stream that takes control characters, for those of our own."""
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
    """The stream that takes control characters."""
    return stream.behind if isinstance(stream, SafeStream) else stream


def counted(n: int, one: str, many: str = "") -> str:
    """Return `1 stop`, `2 stops`; many: the plural where it is not `one` with an s."""
    return f"{n} {one if n == 1 else many or one + 's'}"


def clock(seconds: float) -> str:
    """`4:02`, with hours where there are any; whole seconds that have passed, as a watch shows."""
    minutes, rest = divmod(int(max(seconds, 0.0) + 1e-6), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def when_reached(name: str, seconds: float) -> str:
    """When a state came: `usable after 4:02`; of a mount that was known before, from the start."""
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
    r"""Return the text with each lone surrogate in the letters ``\udcff``; never fails."""
    return _LONE.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def json_text(content: Any, indent: int | None = None) -> str:
    r"""Return JSON that UTF-8 can hold. Raises ValueError for NaN and infinity.

    A lone surrogate becomes the letters ``\udcff`` within its string: as a JSON escape of its own
    (``"\udcff"``) strict readers refuse it, and those that take it cannot print what they got.
    """
    text = json.dumps(content, indent=indent, allow_nan=False, ensure_ascii=False)
    return _LONE.sub(lambda found: f"\\\\u{ord(found[0]):04x}", text)
