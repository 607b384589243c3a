"""Times of a drive as people read them, the same on every screen and page."""

from __future__ import annotations

import math


def clock(seconds: float) -> str:
    """`4:02`, with hours where there are any; whole seconds that have passed, as a watch shows."""
    minutes, rest = divmod(int(max(seconds, 0.0) + 1e-6), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def duration(seconds: float) -> str:
    """Return a length of time: `45 s`, `31 min`, `2.3 h`."""
    if not math.isfinite(seconds):
        return "-"
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200.0 else f"{seconds / 3600:.1f} h"
