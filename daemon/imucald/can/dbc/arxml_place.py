"""Find the place in an ARXML file where the parser stopped, and give a remedy.

The parser assumes that all elements required by the standard are present. If one is missing, it
raises an error of Python that does not name the element. The traceback of this error contains the
element that was being parsed.
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
"""Errors that a missing element causes. The texts of these errors do not name the element."""


def why_refused(error: Exception, text: str) -> str:
    """Return the reason with line, element and remedy; error: the parser's error for the text."""
    inner = getattr(error, "e_arxml", None) or error
    found = _last_element(inner)
    words = " ".join(str(inner).split()) or type(inner).__name__
    if found is None:
        return NO_PACKAGES if isinstance(inner, PYTHONS_OWN) else words
    tag, name = found
    what = MISSING if isinstance(inner, PYTHONS_OWN) else words.rstrip(".")
    return f"{_line(text, tag, name)}{tag} {name}: {what}; {REMEDY}"


def _last_element(error: BaseException) -> tuple[str, str] | None:
    """Tag and short name of the innermost named element that was being parsed."""
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
