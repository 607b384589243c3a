"""Plots of a drive, such as `drive.plot.mount()`. The first plot loads matplotlib."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from imucald.api.columns import HISTORY, Columns
from imucald.api.interchange import library
from imucald.core.errors import ImucaldError
from imucald.mount.estimate import ANGLES
from imucald.mount.mount_words import SD_95

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class DrivePlots:
    """Plots of one drive. Each method draws into `ax` (None: new axes) and returns the axes."""

    def __init__(self, tables: Mapping[str, Columns], summary: Mapping[str, Any]) -> None:
        """summary: the content of `replay --json`."""
        self._tables, self._summary = tables, summary

    def mount(self, ax: Axes | None = None) -> Axes:
        """Plot the three angles [deg] with their 95 % intervals over time [s]."""
        history = self._tables[HISTORY]
        ax = _axes(ax)
        for name in ANGLES:
            value, std = history[f"{name}_deg"], history[f"{name}_std_deg"]
            (line,) = ax.plot(history["t_s"], value, label=name)
            low, high = value - SD_95 * std, value + SD_95 * std
            ax.fill_between(history["t_s"], low, high, color=line.get_color(), alpha=0.2)
        known = history["roll_deg"][history["usable"]]
        if len(known):  # while the mount is unknown, its intervals would hide everything
            shown = [history[f"{n}_deg"][history["usable"]] for n in ANGLES]
            bottom, top = float(np.nanmin(shown)), float(np.nanmax(shown))
            ax.set_ylim(bottom - 5.0, top + 5.0)
        return _finished(ax, "mount [deg], bands: 95 %")

    def signals(self, table: str = "accel", ax: Axes | None = None) -> Axes:
        """Plot the numbers of a table over time [s]. table: a name such as "gyro" or
        "raw/speed"."""
        found = self._tables.get(table)
        if found is None:
            raise ImucaldError(
                f"there is no table {table!r} here; there are: {', '.join(self._tables)}"
            )
        ax = _axes(ax)
        every = max(1, len(found) // 20_000)  # a screen has fewer pixels
        for column in found.columns:
            if column.kind == "float" and column.name != "t_s":
                values = found[column.name][::every]
                ax.plot(found["t_s"][::every], values, label=column.name, lw=0.7)
        return _finished(ax, f"{table} (every {every}.)" if every > 1 else table)

    def evidence(self, ax: Axes | None = None) -> Axes:
        """Plot for each kind of evidence the standard deviations [deg] that the mount would have
        with this evidence alone."""
        found = self._summary["details"].get("evidence_std_deg", {})
        ax = _axes(ax)
        ax.barh(list(found), list(found.values()))
        ax.set_xscale("log")
        ax.set_xlabel("standard deviation [deg]")
        return ax


def _axes(ax: Axes | None) -> Any:
    if ax is not None:
        return ax
    _, found = library("matplotlib.pyplot", "report").subplots()
    return found


def _finished(ax: Any, title: str) -> Axes:
    ax.set_xlabel("time [s]")
    ax.set_title(title)
    ax.legend(loc="best")
    ax.grid(True, alpha=0.3)
    found: Axes = ax
    return found
