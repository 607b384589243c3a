"""Numbers with their nouns, for people."""

from __future__ import annotations


def counted(n: int, one: str, many: str = "") -> str:
    """Return `1 stop`, `2 stops`; many: the plural where it is not `one` with an s."""
    return f"{n} {one if n == 1 else many or one + 's'}"
