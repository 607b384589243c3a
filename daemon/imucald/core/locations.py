"""Where in a YAML file something stands: its key, and the line of that."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

Place = tuple[str | int, ...]
Marks = dict[Place, int]
"""Line (from 1) of every key and item."""


def infinite_places(data: Any, place: Place = ()) -> Iterator[Place]:
    """Where numbers are infinite or none at all, which no key may be."""
    if isinstance(data, float) and not math.isfinite(data):
        yield place
    elif isinstance(data, dict | list):
        for key, value in data.items() if isinstance(data, dict) else enumerate(data):
            yield from infinite_places(value, (*place, key))


def line_of(marks: Marks, place: Place) -> int:
    """Line of a key, or of the nearest one around it."""
    while place and place not in marks:
        place = place[:-1]
    return marks.get(place, 1)


def dotted(place: Place) -> str:
    """Name of a key with all that it stands in; empty for the whole file."""
    text = ""
    for part in place:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


class Document(NamedTuple):
    """What data were read from: the file's name, and the lines that its keys stand in.

    marks: empty where the data come from no text; then there is no line. whole: what the file is
    called where no key is to blame.
    """

    name: str
    marks: Marks
    whole: str = "configuration"

    def located(self, place: Place) -> str:
        """File, line and key, as every mistake in a YAML file begins."""
        where = f"{self.name}:{line_of(self.marks, place)}" if self.marks else self.name
        return f"{where}: {dotted(place) or self.whole}"
