"""Figures of matplotlib as short SVG text, with the same layout on every machine; and colours that
follow the page's light or dark mode."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MultipleLocator

from imucald.core.text import clock
from imucald.mount.estimate import MountState
from imucald.report.pointed_values import pointed_values

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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


INK, SOFT, GRID, RAW, OURS, TRUTH, BAD = (f"#0a0b{i:02x}" for i in range(1, 8))
STATE_COLOURS = {state: f"#0a0c{int(state):02x}" for state in MountState}
"""Placeholder colours that are used while a figure is drawn. `themed` replaces them by the page's
colours."""
THEME: Mapping[str, str] = {
    INK: "--ink", SOFT: "--soft", GRID: "--grid", RAW: "--raw", OURS: "--ours",
    TRUTH: "--truth", BAD: "--bad",
    **{colour: f"--{state.name.lower()}" for state, colour in STATE_COLOURS.items()},
}  # fmt: skip
THEMED: dict[Any, Any] = {
    "axes.edgecolor": SOFT, "axes.labelcolor": INK, "xtick.color": SOFT, "ytick.color": SOFT,
    "text.color": INK, "grid.color": GRID, "figure.facecolor": "none", "axes.facecolor": "none",
    "savefig.facecolor": "none", "hatch.color": SOFT, "axes.titlesize": 9.0,
}  # fmt: skip
NICE_S = (1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200)
"""Possible distances between the ticks of a time axis [s]."""
TICKS = 9


def time_axis(axes: Axes, duration: float) -> None:
    """Label an axis of stream time [s]."""
    axes.set_xlim(0.0, duration)
    axes.xaxis.set_major_formatter(FuncFormatter(clock_text))
    step = next((s for s in NICE_S if duration <= TICKS * s), NICE_S[-1])
    axes.xaxis.set_major_locator(MultipleLocator(step))
    axes.set_xlabel("time [min:s]")


def clock_text(seconds: float, _: object) -> str:
    """Return a time as text, such as `4:02`. The function is a matplotlib formatter."""
    return clock(seconds)


def legend(axes: Axes) -> None:
    """Draw the legend above the axes, in rows. A single curve without a name gets no legend."""
    if not axes.get_legend_handles_labels()[1]:
        return
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, borderaxespad=0.1,
                handlelength=1.8, columnspacing=1.2)  # fmt: skip


def themed(svg: str) -> str:
    """Replace placeholder colours by the page's colours, which depend on light or dark mode."""
    svg = without_name_space(svg)
    for colour, name in THEME.items():
        svg = svg.replace(colour, f"var({name})")
    return svg
