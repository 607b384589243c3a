"""Colours of pictures that follow the page's light or dark mode, and common properties of their
axes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from matplotlib.ticker import FuncFormatter, MultipleLocator

from imucald.core.text import clock
from imucald.mount.estimate import MountState
from imucald.report.svg_figures import without_name_space

if TYPE_CHECKING:
    from matplotlib.axes import Axes

INK, SOFT, GRID, RAW, OURS, TRUTH, BAD = (f"#0a0b{i:02x}" for i in range(1, 8))
STATE_COLOURS = {state: f"#0a0c{int(state):02x}" for state in MountState}
"""Placeholder colours that are used while a figure is drawn. `themed` replaces them by the page's
colours."""
THEME: Mapping[str, str] = {
    INK: "--ink", SOFT: "--soft", GRID: "--grid", RAW: "--raw", OURS: "--ours",
    TRUTH: "--truth", BAD: "--bad",
    **{colour: f"--{state.name.lower()}" for state, colour in STATE_COLOURS.items()},
}  # fmt: skip
STYLE: dict[Any, Any] = {
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
    """Draw the legend above the axes, in rows."""
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, borderaxespad=0.1,
                handlelength=1.8, columnspacing=1.2)  # fmt: skip


def themed(svg: str) -> str:
    """Replace placeholder colours by the page's colours, which depend on light or dark mode."""
    svg = without_name_space(svg)
    for colour, name in THEME.items():
        svg = svg.replace(colour, f"var({name})")
    return svg
