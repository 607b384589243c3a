"""Pictures of a fleet as SVG: vehicles relative to their type, batches, histories, spreads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from imucald.mount.mount_words import VEHICLE_AXES
from imucald.report.plots import AFTER, BEFORE, FLOOR
from imucald.report.svg_figures import drawn

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Row = Mapping[str, Any]
AXES = dict(zip("xyz", VEHICLE_AXES, strict=True))
COLOURS = {"x": BEFORE, "y": "#009E73", "z": AFTER}
"""Colours that are distinguishable with any colour blindness (Okabe and Ito)."""
MAX_LINES = 20
"""Largest number of batches or types in a picture."""
COLUMNS = 90
"""Characters that fit side by side below a picture of the page's width."""


def vehicles_picture(vehicles: Sequence[Row]) -> str:
    """Draw the mount of each vehicle relative to its type, for each axis. Outliers are marked."""
    ordered = sorted(vehicles, key=lambda v: (v["vehicle_type"], v["vehicle"]))
    kinds = [v["vehicle_type"] for v in ordered]
    begins = [i for i, k in enumerate(kinds) if i == 0 or kinds[i - 1] != k]
    odd = np.array([bool(v["outlier"]) for v in ordered])
    is_few = len(ordered) <= MAX_LINES

    def draw(figure: Figure) -> None:
        axes = figure.subplots(3, 1, sharex=True)
        at = np.arange(len(ordered))
        for ax, axis in zip(axes, AXES, strict=True):
            value = np.array([v[f"d_{axis}_deg"] for v in ordered], dtype=float)
            ax.set_axisbelow(True)
            ax.axhline(0.0, color="#888888", linewidth=0.7)
            for begin in begins[1:]:
                ax.axvline(begin - 0.5, color="#BBBBBB", linewidth=0.7)
            size = 26.0 if is_few else 10.0 if len(ordered) < 400 else 4.0
            ax.scatter(at[~odd], value[~odd], s=size, color=AFTER, linewidths=0)
            ax.scatter(at[odd], value[odd], s=26.0, color=BEFORE, marker="D", linewidths=0)
            ax.set_ylabel(f"{AXES[axis]} [deg]")
        ends = [*begins[1:], len(ordered)]
        centres = [(b + e - 1) / 2 for b, e in zip(begins, ends, strict=True)]
        named = len(begins) <= MAX_LINES
        if is_few:
            names = [v["vehicle"] for v in ordered]
            fits = sum(map(len, names)) < COLUMNS
            axes[-1].set_xticks(at, names, rotation=0.0 if fits else 60.0)
        else:
            axes[-1].set_xticks(
                centres if named else [], [kinds[b] for b in begins] if named else []
            )
        axes[-1].set_xlabel("vehicles" if is_few else "vehicles by type")

    return drawn(draw, (9.6, 5.4))


def groups_picture(groups: Sequence[Row]) -> str:
    """Draw the difference between each batch and the other vehicles of the same types, with 95 %
    intervals."""
    judged = [g for g in groups if g["p"] is not None]
    judged = sorted(judged, key=lambda g: g["p"])[:MAX_LINES]
    labels = [
        f"{g['name']} ({g['vehicles']})" + (" *" if g["verdict"] == "bad" else "") for g in judged
    ]

    def draw(figure: Figure) -> None:
        axes = figure.subplots(1, 3, sharey=True)
        for ax, axis in zip(axes, AXES, strict=True):
            effect = np.array([g[f"d_{axis}_deg"] for g in judged], dtype=float)
            half = np.array([g[f"ci95_{axis}_deg"] for g in judged], dtype=float)
            ax.axvline(0.0, color="#888888", linewidth=0.7)
            _bars(ax, effect, half, axis, 1)
            ax.set_xlabel(f"{AXES[axis]} difference from its types [deg]")
        _labelled(axes[0], labels)

    return drawn(draw, (9.6, 1.1 + 0.24 * len(judged)))


def types_picture(types: Sequence[Row]) -> str:
    """Draw the spread between vehicles and the spread between drives for each type, with 95 %
    intervals."""
    shown = list(types)[:MAX_LINES]

    def draw(figure: Figure) -> None:
        axes = figure.subplots(1, 2, sharey=True)
        titles = (("tau", "from vehicle to vehicle [deg]"), ("drive", "from drive to drive [deg]"))
        for ax, (name, title) in zip(axes, titles, strict=True):
            for k, axis in enumerate(AXES):
                value = np.array([t[f"{name}_{axis}_deg"] for t in shown], dtype=float)
                low = value - np.array([t[f"{name}_low_{axis}_deg"] for t in shown], dtype=float)
                high = np.array([t[f"{name}_high_{axis}_deg"] for t in shown], dtype=float) - value
                _bars(ax, value, np.array([low, high]), axis, k)
            most = [t[f"{name}_{a}_deg"] for t in shown for a in AXES]
            ax.set_xlim(0.0, 3.0 * max(max(most, default=0.0), 0.1))
            ax.set_xlabel(title)
        _labelled(axes[0], [t["vehicle_type"] for t in shown])
        names = axes[-1].get_legend_handles_labels()
        figure.legend(*names, ncols=3, loc="outside upper center")

    return drawn(draw, (9.6, 1.6 + 0.34 * len(shown)))


def _bars(ax: Axes, value: Any, width: Any, axis: str, k: int) -> None:
    at = np.arange(len(value)) + 0.2 * (k - 1)
    ax.errorbar(value, at, xerr=width, fmt="o", markersize=3.5, color=COLOURS[axis], linewidth=1.1,
                label=AXES[axis])  # fmt: skip


def _labelled(ax: Axes, labels: Sequence[str]) -> None:
    ax.set_yticks(range(len(labels)), labels)
    ax.set_ylim(len(labels) - 0.5, -0.5)


def history_picture(drives: Sequence[Row], cuts: Sequence[str]) -> str:
    """Draw the mounts of one vehicle's drives in order, relative to the first drive, with 95 %
    intervals. cuts: log keys of the first drive after each remount."""
    from scipy.spatial.transform import Rotation  # noqa: PLC0415 - only for these pictures

    R = Rotation.from_quat([[d[f"q_{n}"] for n in "xyzw"] for d in drives])
    e = (R * R[0].inv()).as_rotvec(degrees=True)

    def draw(figure: Figure) -> None:
        ax = figure.add_subplot()
        at = np.arange(1, len(drives) + 1)
        for k, axis in enumerate(AXES):
            variance = np.array([d[f"cov_{axis}{axis}_deg2"] for d in drives], dtype=float)
            if axis == "x":  # the crown is the same in all drives
                variance -= np.array([d["crown_std_deg"] for d in drives], dtype=float) ** 2
            width = 1.96 * np.sqrt(np.maximum(variance, 0.0))
            ax.errorbar(at + 0.08 * (k - 1), e[:, k], yerr=width, fmt="o", markersize=3.5,
                        color=COLOURS[axis], linewidth=0.9, label=AXES[axis])  # fmt: skip
        for i, d in enumerate(drives, start=1):
            if d["log_key"] in cuts:
                ax.axvline(i - 0.5, color=FLOOR, linestyle="--", linewidth=1.0)
        ax.set_xlabel("drive")
        ax.set_ylabel("turn from the first drive [deg]")
        if len(drives) < 12:
            ax.set_xticks(at)
        figure.legend(ncols=3, loc="outside upper center")

    return drawn(draw, (4.7, 2.7))


def reasons_picture(rows: Sequence[Row]) -> str:
    """Draw the number of drives that never became usable, by missing condition."""
    count: dict[str, int] = {}
    for row in rows:
        count[row["reason"]] = count.get(row["reason"], 0) + row["drives"]
    items = sorted(count.items(), key=lambda item: -item[1])[:MAX_LINES]

    def draw(figure: Figure) -> None:
        ax = figure.add_subplot()
        ax.set_axisbelow(True)
        ax.barh(range(len(items)), [n for _, n in items], color=AFTER, height=0.6)
        _labelled(ax, [reason for reason, _ in items])
        ax.set_xlabel("drives")

    return drawn(draw, (9.6, 0.9 + 0.3 * len(items)))
