"""Show the mount on a terminal. `status`, `monitor` and `replay` use this module."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from imucald.mount.estimate import ANGLES
from imucald.mount.mount_words import (
    ABOUT,
    VEHICLE_AXES,
    angle_cells,
    driving_left,
    is_trouble,
    judged_std,
    percent,
    plus_minus,
    reasons,
    sent_words,
    target_words,
)

BAR = 24
"""Width of a bar [columns]."""


TRY_CHECK = "run 'imucald check' on this bus or on a log: it names a wrong sign, axis or unit"
"""Text about a contradiction between signals. More driving does not remove the contradiction."""


def mount_parts(
    result: Mapping[str, Any], bar: int = BAR, is_stale: bool = False, is_checked: bool = False
) -> Iterator[Table | Text]:
    """Yield the parts of the view, the most useful part first: angles of the housing, orientation
    of the sensor, missing evidence, remaining driving, axes of corrected samples, an explanation of
    "±", and the remaining errors of corrected samples.

    result: as in docs/json.md, or a status (also of an older daemon). bar: width of bars [columns].
    is_stale: no corrected frames are sent now, so no target is shown as reached. is_checked: the
    result of `check` is shown too.
    """
    mount, progress = result["mount"], result.get("progress")
    yield _angles(result)
    for key, style in (("sits", ""), ("steep", "yellow"), ("mirrored", "yellow")):
        if mount.get(key):
            yield Text(mount[key], style=style)
    for names, text in reasons(result["waiting_for"]):
        if is_trouble(text):
            yield Text(f"trouble      {text}", style="bold red")
        elif not is_stale:  # driving does not help while nothing flows
            yield Text(f"waiting for  {names}: {text}", style="yellow")
    if result.get("standing_faults") and not is_checked:
        yield Text(f"next         {TRY_CHECK}", style="yellow")
    if progress is not None:
        yield _gates(progress, bar, is_stale)
    yield _axes(result, is_stale)
    yield Text(ABOUT, style="dim")
    if left := sent_words(result.get("correction")):
        yield Text(f"errors left in corrected frames: {left}")


def _gates(progress: Mapping[str, Any], bar: int, is_stale: bool) -> Table:
    """Make a bar for each missing condition, with its progress and the remaining driving time.

    is_stale: no corrected frames are sent now, so no bar has the colour for good and no time is
    stated.
    """
    unfinished, finished = ("dim", "dim") if is_stale else ("yellow", "green")
    table = Table(box=None, pad_edge=False)
    table.add_column(f"to {progress['goal']}")
    table.add_column("")
    table.add_column("", justify="right")
    table.add_column("")
    for gate in progress["gates"]:
        share = ProgressBar(
            1.0, gate["share"], bar, complete_style=unfinished, finished_style=finished
        )
        left = "" if is_stale else driving_left(gate["left_s"])
        table.add_row(gate["gate"], share, percent(gate["share"]), left)
    return table


def _angles(result: Mapping[str, Any]) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column("mount", min_width=6)
    table.add_column("angle", justify="right", min_width=8)
    table.add_column("± 95 %", justify="right", min_width=7)
    for angle in ANGLES:
        table.add_row(angle, *angle_cells(result["mount"], angle))
    return table


def _axes(result: Mapping[str, Any], is_stale: bool) -> Table:
    """Make the table of the ± of corrected samples about each axis. The state of the mount depends
    on these values."""
    table = Table(box=None, pad_edge=False)
    table.add_column("corrected", min_width=12)
    table.add_column("± 95 %", justify="right", min_width=7)
    table.add_column("target")
    for axis, turn in zip("xyz", VEHICLE_AXES, strict=True):
        words, is_reached = target_words(result, axis)
        text = Text(words, style="dim" if is_stale else "green" if is_reached else "")
        table.add_row(turn, plus_minus(judged_std(result["mount"], axis)), text)
    return table
