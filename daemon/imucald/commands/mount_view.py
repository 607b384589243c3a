"""The mount on a terminal, the same in `status`, `monitor` and `replay`."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from rich.table import Table
from rich.text import Text

from imucald.mount.estimate import ANGLES
from imucald.mount.mount_words import (
    ABOUT,
    SD_95,
    VEHICLE_AXES,
    angle_cells,
    half_width,
    is_trouble,
    judged_std,
    plus_minus,
    reasons,
    sent_words,
)

WIDEST_DEG, NARROWEST_DEG = 16.0, 0.1
"""Intervals that fill a bar, and that leave it empty (log scale)."""
MARK = "┃"
BAR, REST = "━", "─"


def mount_parts(
    mount: Mapping[str, Any],
    waiting_for: Mapping[str, str],
    bar: int = 0,
    correction: Mapping[str, Any] | None = None,
) -> Iterator[Table | Text]:
    """Yield the table, how the sensor sits, what is left, what is missing, and what "±" means.

    mount, waiting_for, correction: as in docs/json.md (of an older daemon too). bar: columns of
    the bars.
    """
    yield _table(mount, bar)
    for key, style in (("sits", ""), ("steep", "yellow"), ("mirrored", "yellow")):
        if mount.get(key):
            yield Text(mount[key], style=style)
    if left := sent_words(correction):
        yield Text(f"sent         {left}")
    for names, text in reasons(waiting_for):
        if is_trouble(text):
            yield Text(f"trouble      {text}", style="bold red")
        else:
            yield Text(f"waiting for  {names}: {text}", style="yellow")
    yield Text(
        ABOUT + (f"; a shorter bar is better, {MARK} is its target (log scale)" if bar else ""),
        style="dim",
    )


def _table(mount: Mapping[str, Any], bar: int) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column("mount", min_width=6)
    table.add_column("angle", justify="right", min_width=8)
    table.add_column("± 95 %", justify="right", min_width=7)
    table.add_column("")  # a gap between the mount and what states are judged by
    table.add_column("turn about", min_width=12)
    table.add_column("± 95 %", justify="right", min_width=7)
    if bar:
        table.add_column("")
    table.add_column("target")
    for angle, axis, turn in zip(ANGLES, "xyz", VEHICLE_AXES, strict=True):
        std = judged_std(mount, axis)
        goal, limit = _target(mount, axis, std)
        cells: list[str | Text] = [angle, *angle_cells(mount, angle), "", turn, plus_minus(std)]
        if bar:
            cells.append(interval_bar(std, limit, bar))
        reached = std is not None and limit is not None and std < limit
        style = "green" if reached else ""
        cells.append(Text(f"{goal} below {plus_minus(limit)}" if limit else "", style=style))
        table.add_row(*cells)
    return table


def _target(mount: Mapping[str, Any], axis: str, std: float | None) -> tuple[str, float | None]:
    """The next state and the standard deviation [deg] from which it is reached."""
    targets = mount.get("target_std_deg")
    if targets is None:
        return "", None
    usable, fine = (float(targets[goal][axis]) for goal in ("usable", "fine"))
    return ("usable", usable) if std is None or std >= usable else ("fine", fine)


def interval_bar(std_deg: float | None, target: float | None, width: int) -> Text:
    """A 95 % interval as a bar on a log scale, with a mark where the target is."""
    half = half_width(std_deg)
    filled = width if half is None else _place(half, width)
    if target is None:
        return _bar(filled, width, "cyan")
    at = min(_place(SD_95 * target, width), width - 2)
    good = half is not None and half < SD_95 * target
    # the mark hides one place: the bar ends before it or goes on behind it, as the interval does
    text = _bar(
        min(filled, at) if good else max(filled, at + 2), width, "green" if good else "cyan"
    )
    return text[:at] + Text(MARK, style="bold") + text[at + 1 :]


def _bar(filled: int, width: int, style: str) -> Text:
    text = Text(BAR * filled + REST * (width - filled), style=style)
    text.stylize("dim", filled)
    return text


def _place(half: float, width: int) -> int:
    part = math.log(max(half, NARROWEST_DEG) / NARROWEST_DEG)
    part /= math.log(WIDEST_DEG / NARROWEST_DEG)
    return min(max(round(part * width), 1), width)
