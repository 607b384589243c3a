"""Text from outside (names of files, keys, vehicles), made fit for a screen or a line of a log.

A terminal obeys control characters; those that turn the direction of writing hide what a text
says. Each is shown as an escape of JSON (``\\u001b``), so that JSON keeps its meaning.
"""

from __future__ import annotations

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
_LINE_BREAKING: Final = re.compile(f"{UNSAFE.pattern}|[\n\t\r]")


def made_safe(text: str, unsafe: re.Pattern[str] = UNSAFE) -> str:
    """The text with its unsafe characters as escapes."""
    return unsafe.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def one_line(text: str) -> str:
    """The text for a cell of a table or a sentence: what would break its line is an escape too."""
    return made_safe(text, _LINE_BREAKING)


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
