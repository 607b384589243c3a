"""Pictures that compare the corrected specific force with the motion of the vehicle."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.ticker import FuncFormatter

from imucald.report.decimation import richest_segment
from imucald.report.drive_history import DriveMotion
from imucald.report.svg_figures import drawn
from imucald.report.themed_figures import OURS, RAW, STYLE, TRUTH, clock_text, legend, themed

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DIVERGING = LinearSegmentedColormap.from_list("imucald", ["#2b6cb0", "#f4f4f4", "#c0561a"])
"""Colour map: blue for negative values, vermilion for positive values. The colours are
distinguishable with any colour blindness."""
MAP = (4.7, 3.5)
SPEED_BINS, TURN_BINS = 14, 12
CELL_ROWS = 5
"""Smallest number of rows in a cell of a map: two and a half seconds."""
DOTS = 700
"""Largest number of points in a picture. More points would make the page larger without a
benefit."""


def stretch_picture(motion: DriveMotion) -> str:
    """Draw corrected force, raw force and the force from the vehicle's motion over time, for one
    minute."""
    rows = telling_rows(motion)

    def draw(figure: Figure) -> None:
        parts = figure.subplots(2, 1, sharex=True)
        names = (("forward", "dv/dt", motion.dvdt), ("left", "speed times yaw rate", motion.turn))
        for i, (axes, (way, what, truth)) in enumerate(zip(parts, names, strict=True)):
            t = motion.t[rows]
            axes.plot(t, motion.raw[rows, i], color=RAW, lw=1.0, label=f"sensor {'xy'[i]}, as sent")
            axes.plot(t, truth[rows], color=TRUTH, lw=1.6, ls=(0, (5, 2)), label=what)
            axes.plot(t, motion.corrected[rows, i], color=OURS, lw=1.4, label="corrected")
            axes.set_ylabel(f"{way} [m/s²]")
            axes.margins(x=0.005)
            legend(axes)
        parts[-1].xaxis.set_major_formatter(FuncFormatter(clock_text))
        parts[-1].set_xlabel("time [min:s]")

    return themed(drawn(draw, (9.6, 4.4), STYLE))


def telling_rows(motion: DriveMotion) -> slice:
    """Return the rows of the minute with the most braking, accelerating and turning. Only minutes
    with a correction are considered."""
    known = np.isfinite(motion.corrected[:, 0])
    worth = np.nan_to_num(motion.dvdt) ** 2 + np.nan_to_num(motion.turn) ** 2
    return richest_segment(motion.t, np.where(known, worth + 1e-9, 0.0), 60.0)


def scatter_picture(motion: DriveMotion, axis: int) -> str:
    """Draw corrected and raw force over the force from the vehicle's motion. axis: 0 forward, 1
    left."""
    truth, what = ((motion.dvdt, "dv/dt"), (motion.turn, "speed times yaw rate"))[axis]
    known = np.isfinite(truth) & np.isfinite(motion.corrected[:, axis])
    rows = np.flatnonzero(known)[:: max(int(known.sum()) // DOTS, 1)]

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        x = truth[rows]
        for values, colour, name in (
            (motion.raw, RAW, "sensor, as sent"),
            (motion.corrected, OURS, "corrected"),
        ):
            axes.plot(
                x, values[rows, axis], "o", ms=2.2, mew=0, alpha=0.5, color=colour, label=name
            )
        if len(x):
            ends = np.array([x.min(), x.max()])
            axes.plot(ends, ends, color=TRUTH, lw=1.2, ls=(0, (5, 2)), label="equal")
        axes.set_xlabel(f"{what} [m/s²]")
        axes.set_ylabel(f"force {('forward', 'left')[axis]} [m/s²]")
        legend(axes)

    return themed(drawn(draw, MAP, STYLE))


def residual_map(motion: DriveMotion, axis: int) -> str:
    """Draw a map of the mean difference between corrected force and force from the motion, over
    speed and lateral acceleration."""
    truth = (motion.dvdt, motion.turn)[axis]
    left = motion.corrected[:, axis] - truth
    known = np.isfinite(left) & np.isfinite(motion.speed) & np.isfinite(motion.turn)

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        axes.set_xlabel("speed [km/h]")
        axes.set_ylabel("lateral acceleration [m/s²]")
        if known.sum() < CELL_ROWS:
            axes.text(0.5, 0.5, "not enough", transform=axes.transAxes, ha="center")
            return
        x, y, z = 3.6 * motion.speed[known], motion.turn[known], left[known]
        reach = max(float(np.percentile(np.abs(y), 99.5)), 0.5)
        cells = (
            np.linspace(min(float(x.min()), 0.0), max(float(x.max()), 1.0), SPEED_BINS + 1),
            np.linspace(-reach, reach, TURN_BINS + 1),
        )
        count, _, _ = np.histogram2d(x, y, cells)
        total, _, _ = np.histogram2d(x, y, cells, weights=z)
        mean = np.where(count >= CELL_ROWS, total / np.maximum(count, 1), np.nan)
        top = max(float(np.nanpercentile(np.abs(mean), 95)), 0.05) if np.isfinite(mean).any() else 1
        drawn_map = axes.pcolormesh(*cells, mean.T, cmap=DIVERGING, vmin=-top, vmax=top, lw=0,
                                   label="corrected minus motion [m/s²]")  # fmt: skip
        bar = figure.colorbar(drawn_map, ax=axes, extend="both")
        bar.outline.set_visible(False)
        axes.grid(visible=False)

    return themed(drawn(draw, MAP, STYLE))
