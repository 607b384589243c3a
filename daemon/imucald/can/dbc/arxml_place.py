"""Where in an ARXML file the parser stopped, and what to do about it.

The parser takes for granted what the standard asks for, and answers with Python's words where it is
missing. The element that it was at is still in the frames of its error.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

REMEDY = "correct the file, remove this element, or export the bus as DBC"
NO_PACKAGES = (
    "the file has no packages (AR-PACKAGES) that describe a bus; export the system "
    "description of the bus, or export the bus as DBC"
)
MISSING = "an element that the standard requires is missing"
PYTHONS_OWN = (AttributeError, TypeError, KeyError, IndexError)
"""What a missing element leads to; its words name no element."""


def why_refused(error: Exception, text: str) -> str:
    """Reason with line, element and remedy; error: what the parser raised of the text."""
    inner = getattr(error, "e_arxml", None) or error
    found = _last_element(inner)
    words = " ".join(str(inner).split()) or type(inner).__name__
    if found is None:
        return NO_PACKAGES if isinstance(inner, PYTHONS_OWN) else words
    tag, name = found
    what = MISSING if isinstance(inner, PYTHONS_OWN) else words.rstrip(".")
    return f"{_line(text, tag, name)}{tag} {name}: {what}; {REMEDY}"


def _last_element(error: BaseException) -> tuple[str, str] | None:
    """Tag and short name of the innermost element with a name that the parser was at."""
    found = None
    traceback = error.__traceback__
    while traceback is not None:
        for one in _named(traceback.tb_frame.f_locals.values()):
            found = one
        traceback = traceback.tb_next
    return found


def _named(values: Any) -> Iterator[tuple[str, str]]:
    for value in values:
        tag = getattr(value, "tag", None)
        if isinstance(tag, str) and hasattr(value, "findtext"):
            name = value.findtext("{*}SHORT-NAME")
            if name:
                yield tag.rpartition("}")[2], name


def _line(text: str, tag: str, name: str) -> str:
    begin = rf"<(?:\w+:)?{re.escape(tag)}\b[^>]*>\s*<(?:\w+:)?SHORT-NAME\b[^>]*>\s*"
    found = re.search(begin + re.escape(name) + r"\s*<", text)
    return "" if found is None else f"line {text.count(chr(10), 0, found.start()) + 1}, "
