"""The picture of `imucald demo`: the present state, and the history of the uncertainty of each
angle."""

from __future__ import annotations

import math
import textwrap
import time

from rich.console import Group
from rich.padding import Padding
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from imucald.commands.demo_drive import Demonstration, angles_beside
from imucald.core.angles import DEG_PER_RAD
from imucald.core.rotations import angles_from_rotation
from imucald.core.text import clock
from imucald.mount.estimate import ANGLES, MountState
from imucald.mount.mount_words import (
    SD_95,
    plus_minus,
    reasons,
)

COLUMNS = 80
HISTORY = 24
"""Width of the history of an angle's uncertainty [columns]."""
BLOCKS = " ▁▂▃▄▅▆▇█"
WIDEST_DEG, NARROWEST_DEG = 12.0, 0.25
"""A column of the history is full at the first 95 % interval and empty at the second [deg]. The
scale between them is logarithmic."""
_STYLES = {
    MountState.USABLE: "green",
    MountState.FINE: "bold green",
    MountState.SUSPECT: "red",
    MountState.RECALIBRATING: "red",
}


class Picture:
    """Draws the present state of a demonstration, with the history of the uncertainty of each
    angle."""

    def __init__(self) -> None:
        self._began = time.monotonic()
        self._history: dict[str, list[float]] = {name: [] for name in ANGLES}

    def note(self, demo: Demonstration) -> None:
        """Add the present uncertainty to the history."""
        columns = min(int(HISTORY * demo.now / demo.drive.duration_s), HISTORY)
        if columns <= len(self._history["yaw"]):
            return
        angles = {a.name: a for a in angles_beside(demo.estimate(), demo.truth)}
        for name, history in self._history.items():
            width = SD_95 * angles[name].std if name in angles else math.inf
            history.extend([width] * (columns - len(history)))

    def draw(self, demo: Demonstration, steady: bool = True) -> Group:
        """Return the picture: twenty lines if the terminal has 80 columns. steady: if True, the
        height never changes."""
        estimate = demo.estimate()
        reports = [f"waiting for  {who}: {text}" for who, text in reasons(estimate.waiting_for)]
        waiting = [line for text in reports for line in textwrap.wrap(text, COLUMNS)]
        if steady:
            waiting += [""] * (len(ANGLES) - len(waiting))
        return Group(
            _headline(demo),
            Padding(_state_line(demo), (1, 0)),
            self._angle_table(demo),
            Padding(
                Text("\n".join(waiting), style="yellow"),
                (1, 0, 0, 0),
            ),
            Padding(_acceleration_table(demo), (1, 0)),
            _traffic_line(demo, time.monotonic() - self._began if steady else None),
        )

    def _angle_table(self, demo: Demonstration) -> Table:
        angles = {a.name: a for a in angles_beside(demo.estimate(), demo.truth)}
        truth = dict(zip(ANGLES, angles_from_rotation(demo.truth), strict=True))
        table = Table(box=None, pad_edge=False)
        table.add_column("mount", min_width=6)
        for name in ("estimate", "± 95 %", "truth"):
            table.add_column(name, justify="right", min_width=9)
        table.add_column("± 95 % so far (log scale)", min_width=HISTORY)
        for name in ANGLES:
            found = angles.get(name)
            cells = ("-", "-") if found is None else (degrees(found.estimate), interval(found.std))
            history = Text(_history(self._history[name]), style="cyan")
            table.add_row(name, *cells, degrees(truth[name]), history)
        return table


def _headline(demo: Demonstration) -> Table:
    grid = Table.grid(padding=(0, 2))
    speed, _, yaw_rate = demo.motion()
    turn = "left" if yaw_rate > 0.03 else "right" if yaw_rate < -0.03 else "straight on"
    doing = "standing" if abs(speed) < 0.1 else f"{3.6 * speed:3.0f} km/h, {turn}"
    grid.add_row(
        Text("imucald demo", style="bold"),
        ProgressBar(demo.drive.duration_s, min(demo.now, demo.drive.duration_s), width=24),
        f"{clock(demo.now)} of {clock(demo.drive.duration_s)}",
        doing,
    )
    return grid


def _state_line(demo: Demonstration) -> Text:
    estimate, pipeline = demo.estimate(), demo.engine.pipeline
    text = Text("state  ")
    text.append(estimate.state.name.lower(), style=_STYLES.get(estimate.state, "yellow"))
    times = (("usable", pipeline.first_usable), ("fine", pipeline.first_fine))
    reached = [f"{name} after {clock(t)}" for name, t in times if t is not None]
    none = "all corrected frames say 'not available' so far"
    text.append("   " + (", ".join(reached) or none))
    return text


def _acceleration_table(demo: Demonstration) -> Table:
    measured, corrected = demo.acceleration()
    table = Table(box=None, pad_edge=False)
    table.add_column("acceleration [m/s²]")
    for axis in ("x", "y", "z"):
        table.add_column(axis, justify="right", min_width=8)
    table.add_row("as the sensor sends it", *(f"{v:+.2f}" for v in measured))
    received = ["n/a"] * 3 if corrected is None else [f"{v:+.2f}" for v in corrected]
    table.add_row("as received from imucald", *received)
    return table


def _traffic_line(demo: Demonstration, waited: float | None) -> Text:
    now = max(demo.now, 1e-9)
    rejected = demo.engine.router.rejected.total()
    text = f"{demo.sent / now:.0f} frames/s in, {demo.engine.sent / now:.0f}/s out"
    text += f", {rejected} rejected"
    if waited is not None:
        text += f", {now / max(waited, 1e-9):.0f} times real time"
    return Text(text, style="dim")


def degrees(angle: float) -> str:
    """Format an angle [rad] in degrees, with its sign."""
    return f"{angle * DEG_PER_RAD:+.2f}°"


def interval(std: float) -> str:
    """Format the 95 % interval of a standard deviation [rad] in degrees."""
    return plus_minus(std * DEG_PER_RAD)


def _history(widths: list[float]) -> str:
    return "".join(_block(w * DEG_PER_RAD) for w in widths)


def _block(width_deg: float) -> str:
    if not math.isfinite(width_deg):
        return "·"
    span = math.log(WIDEST_DEG / NARROWEST_DEG)
    part = math.log(max(width_deg, NARROWEST_DEG) / NARROWEST_DEG) / span
    return BLOCKS[min(max(math.ceil(part * 8.0), 1), 8)]
