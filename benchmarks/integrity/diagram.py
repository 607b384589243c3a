"""The Stanford diagram as SVG: stated bound against true error, one point a second."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

from benchmarks.integrity.judge import ALERT_LIMIT_DEG, BIN_DECADE, DEVIATIONS, LOWEST_DEG

HIGHEST_DEG = 180.0
PIXELS_DECADE = 110.0
LEFT, TOP, RIGHT, BOTTOM = 60.0, 40.0, 20.0, 50.0
SIDE = PIXELS_DECADE * math.log10(HIGHEST_DEG / LOWEST_DEG)
TICKS = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
SOUND, WRONG = "#2a6f97", "#c1121f"


COMMAND = "python -m benchmarks.integrity --diagram FILE"


def diagram(lines: Sequence[dict[str, Any]]) -> str:
    """SVG of all points of all drives."""
    cells: Counter[tuple[int, int]] = Counter()
    for line in lines:
        for key, n in line["points"].items():
            i, j = key.split(",")
            cells[int(i), int(j)] += n
    width, height = LEFT + SIDE + RIGHT, TOP + SIDE + BOTTOM
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}"'
        f' width="{width:.0f}" height="{height:.0f}" font-family="sans-serif" font-size="12">',
        f"<metadata>{COMMAND}</metadata>",
        f'<rect width="{width:.0f}" height="{height:.0f}" fill="white"/>',
        *_region(),
        *_points(cells),
        *_axes(),
        *_words(cells),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def is_misleading(i: int, j: int) -> bool:
    """Whether a cell's error lies beyond alert limit and stated bound."""
    return i > j and i >= BIN_DECADE * math.log10(ALERT_LIMIT_DEG / LOWEST_DEG)


def _x(degrees: float) -> float:
    return LEFT + PIXELS_DECADE * math.log10(degrees / LOWEST_DEG)


def _y(degrees: float) -> float:
    return TOP + SIDE - PIXELS_DECADE * math.log10(degrees / LOWEST_DEG)


def _region() -> Iterator[str]:
    """Where points are misleading."""
    limit, high, low = ALERT_LIMIT_DEG, HIGHEST_DEG, LOWEST_DEG
    corners = [(limit, low), (limit, limit), (high, high), (high, low)]
    text = " ".join(f"{_x(a):.1f},{_y(b):.1f}" for a, b in corners)
    yield f'<polygon points="{text}" fill="{WRONG}" fill-opacity="0.10"/>'


def _points(cells: Counter[tuple[int, int]]) -> Iterator[str]:
    size = PIXELS_DECADE / BIN_DECADE
    most = math.log1p(max(cells.values(), default=1))
    top = int(SIDE / size) - 1
    for (i, j), n in sorted(cells.items()):
        shade = 0.15 + 0.85 * math.log1p(n) / most
        x, y = LEFT + min(i, top) * size, TOP + SIDE - (min(j, top) + 1) * size
        colour = WRONG if is_misleading(i, j) else SOUND
        yield (
            f'<rect x="{x:.1f}" y="{y:.1f}" width="{size:.1f}" height="{size:.1f}"'
            f' fill="{colour}" fill-opacity="{shade:.2f}"/>'
        )


def _axes() -> Iterator[str]:
    line = 'stroke="black" stroke-width="1"'
    yield f'<rect x="{LEFT}" y="{TOP}" width="{SIDE:.1f}" height="{SIDE:.1f}" fill="none" {line}/>'
    low, high = LOWEST_DEG, HIGHEST_DEG
    ends = f'x1="{_x(low):.1f}" y1="{_y(low):.1f}" x2="{_x(high):.1f}" y2="{_y(high):.1f}"'
    yield f"<line {ends} {line}/>"
    dashed = f'{line} stroke-dasharray="4 3"'
    at = _x(ALERT_LIMIT_DEG)
    yield f'<line x1="{at:.1f}" y1="{TOP}" x2="{at:.1f}" y2="{TOP + SIDE:.1f}" {dashed}/>'
    for tick in TICKS:
        x, y = _x(tick), _y(tick)
        yield f'<text x="{x:.1f}" y="{TOP + SIDE + 16:.1f}" text-anchor="middle">{tick:g}</text>'
        yield f'<text x="{LEFT - 6:.1f}" y="{y + 4:.1f}" text-anchor="end">{tick:g}</text>'


def _words(cells: Counter[tuple[int, int]]) -> Iterator[str]:
    seconds = sum(cells.values())
    wrong = sum(n for cell, n in cells.items() if is_misleading(*cell))
    middle, below = LEFT + 0.5 * SIDE, TOP + SIDE + 38.0
    share = f"{100.0 * wrong / seconds:.2f} %" if seconds else "none"
    yield (
        f'<text x="{middle:.1f}" y="24" text-anchor="middle" font-size="14">'
        f"{seconds} s sent as usable or fine, {wrong} s of them misleading ({share})</text>"
    )
    yield f'<text x="{middle:.1f}" y="{below:.1f}" text-anchor="middle">true error, deg</text>'
    yield (
        f'<text transform="translate(16 {TOP + 0.5 * SIDE:.1f}) rotate(-90)"'
        f' text-anchor="middle">stated bound: {DEVIATIONS:g} deviations, deg</text>'
    )
    yield (
        f'<text x="{_x(14.0):.1f}" y="{_y(0.025):.1f}" text-anchor="middle" fill="{WRONG}">'
        "misleading</text>"
    )
