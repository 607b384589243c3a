"""Figures of matplotlib as short SVG text, with the same layout on every machine."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Callable, Mapping
from typing import Any

import matplotlib as mpl
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from imucald.report.pointed_values import pointed_values

LAYOUT_FONT = "DejaVu Sans"
"""Font for the layout of pictures. The font is part of matplotlib, so the layout is the same on
every machine. DejaVu Sans is a wide font, so texts in other fonts fit too."""
READERS_FONTS = "'Helvetica Neue', Arial, 'Liberation Sans', 'DejaVu Sans'"
LONG_LINE = 40
"""A path with at least this number of commands is a curve of data, not a marker or letter."""

STYLE: dict[Any, Any] = {
    "text.parse_math": False,  # names come from databases: a dollar sign is no formula
    "svg.fonttype": "none",
    "svg.hashsalt": "imucald",
    "font.family": "sans-serif",
    "font.sans-serif": [LAYOUT_FONT],
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#888888",
    "axes.labelcolor": "#333333",
    "axes.linewidth": 0.7,
    "xtick.color": "#555555",
    "ytick.color": "#555555",
    "axes.grid": True,
    "grid.color": "#E4E4E4",
    "grid.linewidth": 0.6,
    "axes.formatter.useoffset": False,
    "axes.unicode_minus": True,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
}


def drawn(
    draw: Callable[[Figure], None],
    size: tuple[float, float],
    style: Mapping[str, Any] | None = None,
) -> str:
    """Draw a figure of the given size [in], and return it as SVG text. draw: function that draws on
    the figure."""
    with mpl.rc_context(STYLE | dict(style or {})), warnings.catch_warnings():
        # The layout font lacks letters of other scripts; the reader's font has them.
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        figure = Figure(figsize=size, layout="constrained")
        FigureCanvasSVG(figure)
        draw(figure)
        out = io.StringIO()
        nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
        figure.savefig(out, format="svg", metadata=nothing)
        values = pointed_values(figure)
    return _shortened(out.getvalue()).replace("</svg>", f"{values}</svg>")


def _shortened(svg: str) -> str:
    """Remove parts that a browser does not need. The size is reduced to a third. In the shortened
    picture, texts use the fonts of the reader's browser.
    """
    svg = svg[svg.index("<svg") :].replace(f"'{LAYOUT_FONT}'", READERS_FONTS)
    svg = re.sub(r'( d=")([^"]*)"', lambda m: f'{m[1]}{short_path(m[2])}"', svg)
    svg = re.sub(r' transform="rotate\(-?0 [^)]*\)"', "", svg)
    svg = re.sub(r'(?<= )([xy])="([-\d.]+)"', lambda m: f'{m[1]}="{_number(m[2], 1)}"', svg)
    # ids of several pictures on one page would collide
    used = set(re.findall(r'(?:href="#|url\(#)([^")]*)', svg))
    svg = re.sub(r' id="([^"]*)"', lambda m: m[0] if m[1] in used else "", svg)
    svg = re.sub(r"\n\s*<", "\n<", svg)
    # Markers in a row that look the same have one style.
    markers = r'<use [^>]*(style="[^"]*")/>\n(?:<use [^>]*\1/>\n){2,}'
    return re.sub(markers, lambda m: f"<g {m[1]}>\n{m[0].replace(' ' + m[1], '')}</g>\n", svg)


def without_name_space(svg: str) -> str:
    """Return the SVG text without its name space, for use within HTML."""
    return re.sub(r' xmlns(:xlink)?="[^"]*"', "", svg)


def short_path(path: str) -> str:
    """Shorten the path data of matplotlib (one command per line).

    Curves of data are rounded to tenths of a point (a seventh of a pixel on a wide page), and
    repeated points are removed. Markers and letters are small, so they are rounded to hundredths.
    """
    lines = path.split("\n")
    is_data = len(lines) > LONG_LINE
    short: list[str] = []
    command = place = ""
    for line in lines:
        letter, _, rest = line.strip().partition(" ")
        numbers = " ".join(_number(text, 1 if is_data else 2) for text in rest.split())
        if is_data and letter == "L" and numbers == place:
            continue
        again = letter == command == "L"  # further points of a line need no letter
        short.append(numbers if again else f"{letter}{numbers}")
        command, place = letter, numbers
    return " ".join(short).strip()


def _number(text: str, digits: int) -> str:
    """Return a number as text with at most `digits` decimals."""
    short = f"{float(text):.{digits}f}".rstrip("0").rstrip(".")
    return "0" if short in {"-0", ""} else short
