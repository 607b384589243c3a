"""Pictures of one replayed drive as SVG. Their colours follow the page's light or dark mode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.ticker import FuncFormatter, MaxNLocator

from imucald.core.angles import DEG_PER_RAD
from imucald.core.arrays import Array
from imucald.mount.estimate import ANGLES, MountState
from imucald.mount.mount_words import EVIDENCE_KINDS, SD_95
from imucald.report.decimation import richest_segment
from imucald.report.drive_history import DriveHistory, DriveMotion
from imucald.report.svg_figures import (
    BAD,
    INK,
    OURS,
    RAW,
    SOFT,
    STATE_COLOURS,
    THEMED,
    TRUTH,
    clock_text,
    drawn,
    legend,
    themed,
    time_axis,
)
from imucald.runtime.drive_events import Event
from imucald.runtime.pipeline import Snapshot

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

KIND_COLOURS = dict(
    zip(
        EVIDENCE_KINDS.values(),
        ("#e69f00", "#0072b2", "#56b4e9", "#009e73", "#cc79a7"),
        strict=True,
    )
)
LARGEST_DEG = 30.0
LABEL_SHARE = 0.02
"""Event numbers in a picture would overlap if their distance were less than this share of the
picture's width."""
MAX_MARKS = 12
"""Largest number of numbered events in a picture."""


Numbered = tuple[int, Event]
"""An event with its number in the pictures and in the table."""


def mount_picture(history: DriveHistory, events: Sequence[Numbered]) -> str:
    """Draw roll, pitch and yaw of the mount over time, with their 95 % intervals."""
    known = [m for m in history.moments if m.estimate.R_vehicle_from_sensor is not None]

    def draw(figure: Figure) -> None:
        parts = figure.subplots(
            4, 1, sharex=True, gridspec_kw={"height_ratios": [0.22, 1.0, 1.0, 1.0]}
        )
        _draw_states(parts[0], history, events)
        for axes, angle in zip(parts[1:], range(3), strict=True):
            _draw_angle(axes, known, angle, events)
        time_axis(parts[-1], history.duration_s)

    return themed(drawn(draw, (9.6, 5.2), THEMED))


def _draw_states(axes: Axes, history: DriveHistory, events: Sequence[Numbered]) -> None:
    """Draw a strip in the colours of the states, with the numbers of the events above it."""
    for state, start, stop in _stretches(history):
        axes.axvspan(start, stop, color=STATE_COLOURS[state], lw=0)
        if stop - start > 0.07 * history.duration_s:
            axes.text(0.5 * (start + stop), 0.5, state.name.lower(), ha="center", va="center",
                      fontsize=8, color=INK)  # fmt: skip
    for t, numbers in _labels(events[:MAX_MARKS], history.duration_s):
        axes.text(t, 1.12, numbers, ha="center", va="bottom", fontsize=8)
    axes.set_ylim(0.0, 1.0)
    axes.set_axis_off()


def _labels(events: Sequence[Numbered], duration: float) -> list[tuple[float, str]]:
    """Return positions and texts of the numbers of events. Events that are close together share one
    text, such as "4-6"."""
    found: list[list[Numbered]] = []
    for mark in events:
        if found and mark[1].t - found[-1][0][1].t < LABEL_SHARE * duration:
            found[-1].append(mark)
        else:
            found.append([mark])
    return [(g[0][1].t, str(g[0][0]) if len(g) == 1 else f"{g[0][0]}-{g[-1][0]}") for g in found]


def _stretches(history: DriveHistory) -> list[tuple[MountState, float, float]]:
    found: list[tuple[MountState, float, float]] = []
    before = 0.0
    for moment in history.moments:
        state = moment.estimate.state
        if found and found[-1][0] is state:
            found[-1] = (state, found[-1][1], moment.t)
        else:
            found.append((state, before, moment.t))
        before = moment.t
    return found


def _draw_angle(
    axes: Axes, moments: Sequence[Snapshot], angle: int, events: Sequence[Numbered]
) -> None:
    table = np.array([(m.t, *_angle(m, angle)) for m in moments]).reshape(len(moments), 3)
    t, value, half = table.T
    known = half < SD_95 * DEG_PER_RAD
    half = np.where(known, half, np.nan)
    end = value[-1] if len(value) else np.nan
    off = np.where(known, (value - end + 180.0) % 360.0 - 180.0, np.nan)
    size = _size(off, half)
    axes.fill_between(t, end + off - half, end + off + half, color=OURS, alpha=0.22, lw=0)
    axes.plot(t, end + off, color=OURS, lw=1.4)
    for _, event in events[:MAX_MARKS]:
        axes.axvline(event.t, color=SOFT, lw=0.7, ls=(0, (1, 2)))
    if np.isfinite(end):
        axes.axhline(end, color=SOFT, lw=0.6)
        axes.set_ylim(end - size, end + size)
    axes.set_ylabel(f"{ANGLES[angle]} [deg]")
    axes.yaxis.set_major_locator(MaxNLocator(5))
    axes.ticklabel_format(axis="y", useOffset=False)


def _angle(moment: Snapshot, angle: int) -> tuple[float, float]:
    """Return an angle of the mount, and the half width of its 95 % interval [deg]."""
    angles, std = moment.estimate.angles, moment.estimate.angle_std
    if angles is None or std is None:
        return np.nan, np.inf
    return angles[angle] * DEG_PER_RAD, SD_95 * std[angle] * DEG_PER_RAD


def _size(off: Array, half: Array) -> float:
    """Return half of the height of a picture of angles [deg]. All angles of the last three quarters
    of the drive are visible; angles of the first quarter may be outside the picture."""
    late = slice(len(off) // 4, None)
    edge = np.abs(off[late]) + half[late]
    if not np.isfinite(edge).any():
        return LARGEST_DEG
    return float(min(max(1.15 * np.nanmax(edge), 1.5 * np.nan_to_num(half[-1])), LARGEST_DEG))


def arrivals_picture(history: DriveHistory) -> str:
    """Draw the sample rate of each signal over time, with gaps and rejections."""
    arrivals, rejected = history.arrivals, history.rejected
    channels = sorted(set(arrivals) | set(rejected))
    duration = max(history.duration_s, 1.0)
    edges = np.linspace(0.0, duration, 241)
    middle, width = 0.5 * (edges[1:] + edges[:-1]), edges[1] - edges[0]

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        for i, channel in enumerate(reversed(channels)):
            t = arrivals.get(channel, np.zeros(0))
            count, _ = np.histogram(t, edges)
            usual = float(np.median(count[count > 0])) if count.any() else 1.0
            height = 0.8 * np.minimum(count / usual, 1.15)
            axes.fill_between(middle, i, i + height, color=OURS, alpha=0.75, lw=0, step="mid")
            axes.text(duration * 1.01, i + 0.3, f"{len(t) / duration:.4g}/s", fontsize=8)
            if channel in rejected:
                bad, _ = np.histogram(rejected[channel], edges)
                axes.fill_between(middle, i, i + 0.8 * (bad > 0), color=BAD, lw=0, step="mid")
        axes.set_yticks(np.arange(len(channels)) + 0.4, list(reversed(channels)))
        axes.set_xlim(0.0, duration + width)
        axes.set_ylim(-0.1, len(channels))
        axes.grid(visible=False)
        axes.spines["left"].set_visible(False)
        axes.tick_params(axis="y", length=0)
        time_axis(axes, duration)

    return themed(drawn(draw, (9.6, 0.6 + 0.3 * max(len(channels), 2)), THEMED))


def evidence_picture(history: DriveHistory, angle: str) -> str | None:
    """Draw the shares of the kinds of evidence in an angle over time. Return None if no shares are
    reported."""
    rows = []
    for moment in history.moments:
        shares = moment.estimate.details.get("evidence_share")
        if isinstance(shares, Mapping) and isinstance(shares.get(angle), Mapping):
            rows.append((moment.t, grouped(shares[angle])))
    if not rows:
        return None
    kinds = sorted({kind for _, shares in rows for kind in shares})
    t = np.array([moment for moment, _ in rows])
    parts = np.array([[shares.get(kind, 0.0) for kind in kinds] for _, shares in rows]).T

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        colours = [KIND_COLOURS.get(kind, "#999999") for kind in kinds]
        axes.stackplot(t, 100.0 * parts, labels=kinds, colors=colours, lw=0)
        axes.set_ylim(0.0, 100.0)
        axes.set_ylabel(f"{angle} [%]")
        axes.margins(x=0.0)
        time_axis(axes, history.duration_s)
        handles, labels = axes.get_legend_handles_labels()
        axes.legend(handles, labels, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3,
                    borderaxespad=0.1, handlelength=1.0, columnspacing=1.0)  # fmt: skip

    return themed(drawn(draw, (4.7, 2.6), THEMED))


def grouped(shares: Mapping[str, float]) -> dict[str, float]:
    """Return the sums of shares by kind of evidence. The kind is the last part of the name of a
    source."""
    found: dict[str, float] = {}
    for source, share in shares.items():
        kind = EVIDENCE_KINDS.get(source.rpartition("_")[2], source)
        found[kind] = found.get(kind, 0.0) + float(share)
    return found


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

    return themed(drawn(draw, (9.6, 4.4), THEMED))


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

    return themed(drawn(draw, MAP, THEMED))


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

    return themed(drawn(draw, MAP, THEMED))
