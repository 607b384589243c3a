"""Figures of matplotlib as short SVG text, laid out alike on every machine."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Callable, Mapping
from typing import Any

import matplotlib as mpl
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

LAYOUT_FONT = "DejaVu Sans"
"""Comes with matplotlib, so pictures are laid out alike anywhere; it is wide."""
READERS_FONTS = "'Helvetica Neue', Arial, 'Liberation Sans', 'DejaVu Sans'"
METADATA = ("Date", "Creator", "Format", "Type")
PATH = re.compile(r'( d=")([^"]*)"')
FINE = re.compile(r"(\.\d\d)\d+")

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
    """Return what `draw` puts on a figure of that size [in] as SVG text."""
    with mpl.rc_context(STYLE | dict(style or {})), warnings.catch_warnings():
        # Letters of other scripts are missing in the font of the layout, not in the reader's.
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        figure = Figure(figsize=size, layout="constrained")
        FigureCanvasSVG(figure)
        draw(figure)
        out = io.StringIO()
        figure.savefig(out, format="svg", metadata=dict.fromkeys(METADATA))
    return _shortened(out.getvalue())


def _shortened(svg: str) -> str:
    """Drop what a browser does not need: half the size, the same picture.

    Paths keep hundredths of a point; text takes the reader's fonts.
    """
    start = svg.index("<svg")
    return PATH.sub(lambda m: m[1] + FINE.sub(r"\1", m[2]) + '"', svg[start:]).replace(
        f"'{LAYOUT_FONT}'", READERS_FONTS
    )
