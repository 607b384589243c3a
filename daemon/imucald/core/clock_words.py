"""Times of a drive as people read them, the same on every screen and page."""

from __future__ import annotations


def clock(seconds: float) -> str:
    """`4:02`, with hours where there are any; whole seconds that have passed, as a watch shows."""
    minutes, rest = divmod(int(max(seconds, 0.0) + 1e-6), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"
