"""What `imucald demo` shows: a live picture or lines of text, then the result, also as SVG."""

from __future__ import annotations

import io
import math
import re
import textwrap
import time
from pathlib import Path
from typing import Any, Self

from rich._export_format import CONSOLE_SVG_FORMAT
from rich.console import Console, Group
from rich.live import Live
from rich.padding import Padding
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from imucald.commands.demo_drive import LAST_S, Angle, Demonstration, angles_beside
from imucald.commands.files import with_origin, write_text
from imucald.commands.terminal import plain_console
from imucald.core.angles import DEG_PER_RAD
from imucald.core.rotations import angles_from_rotation
from imucald.core.text import clock, when_reached
from imucald.mount.estimate import ANGLES, MountState
from imucald.mount.mount_words import (
    CONVENTION,
    SD_95,
    how_it_sits,
    plus_minus,
    reasons,
    steep_note,
)

HISTORY = 24
"""Width of the history of an angle's uncertainty [columns]."""
BLOCKS = " ▁▂▃▄▅▆▇█"
WIDEST_DEG, NARROWEST_DEG = 12.0, 0.25
"""A column of the history is full at the first 95 % interval and empty at the second [deg]. The
scale between them is logarithmic."""
FASTEST = 24.0
"""Fastest speed on a terminal, as a multiple of real time, so that the user can follow."""
LINE_S = 15.0
"""Period of plain lines [s of driving]."""
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
        waiting = [line for text in reports for line in textwrap.wrap(text, 80)]
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


class PlainView:
    """Prints a line from time to time."""

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._next = LINE_S

    def __enter__(self) -> Self:
        print(f"A simulated drive (seed {self._seed}) on a virtual CAN bus, imucald listening.")
        print(
            "   time  state             roll 95 %        pitch 95 %          yaw 95 %  waiting for"
        )
        return self

    def __exit__(self, *_: object) -> None:
        """Do nothing, because nothing is open."""

    def show(self, demo: Demonstration) -> None:
        """Print a line when one is due."""
        if demo.now < self._next:
            return
        self._next += LINE_S
        estimate = demo.estimate()
        found = {a.name: a for a in angles_beside(estimate, demo.truth)}
        cells = "".join(f"{_with_interval(found.get(name)):>18}" for name in ANGLES)
        waiting = next((text for _, text in reasons(estimate.waiting_for)), "")
        state = estimate.state.name.lower()
        print(f"{clock(demo.now):>7}  {state:<9}{cells}  {waiting}".rstrip(), flush=True)


class LiveView:
    """Shows a live picture."""

    def __init__(self, seed: int) -> None:
        self._live = Live(console=plain_console(), auto_refresh=False, transient=True)
        self._picture = Picture()
        self._began = time.monotonic()
        self._drawn = -math.inf

    def __enter__(self) -> Self:
        self._live.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self._live.__exit__(*error)

    def show(self, demo: Demonstration) -> None:
        """Draw the picture when it is due."""
        self._picture.note(demo)
        now = time.monotonic()
        ahead = demo.now / FASTEST - (now - self._began)
        if ahead > 0.0:
            time.sleep(ahead)
        if now - self._drawn >= 0.1 or demo.now >= demo.drive.duration_s:
            self._drawn = now
            self._live.update(self._picture.draw(demo), refresh=True)


def _with_interval(angle: Angle | None) -> str:
    if angle is None:
        return "-"
    return f"{angle.estimate * DEG_PER_RAD:+.2f} {plus_minus(angle.std * DEG_PER_RAD, unit='')}"


def write_svg(demo: Demonstration, picture: Picture, path: Path, command: str) -> None:
    """Write the last picture and the result as SVG. Raises ImucaldError if that fails.

    command: the command line of the demo, for the picture's metadata. The file contains no time of
    the machine, so that the same command writes the same file again.
    """
    console = Console(
        record=True,
        file=io.StringIO(),
        width=82,
        force_terminal=True,
        highlight=False,
        markup=False,
    )
    console.print(picture.draw(demo, steady=False))
    print_result(demo, None, console)
    form = re.sub(r"@font-face \{\{.*?\}\}", "", CONSOLE_SVG_FORMAT, flags=re.DOTALL)
    svg = console.export_svg(title="imucald demo", code_format=form)
    write_text(path, with_origin(svg, command))


def print_result(demo: Demonstration, waited: float | None, console: Console | None = None) -> None:
    """Print estimate and truth, the comparison of the frames, and the next steps.

    waited: real time that the drive took [s]; with None, no time is printed.
    """
    console = console or plain_console()
    angles = angles_beside(demo.estimate(), demo.truth)
    console.print()
    if angles:
        console.print(_result_table(angles))
        console.print(Text(CONVENTION, style="dim"))
        if sits := how_it_sits(demo.estimate()):
            console.print(f"The sensor: {sits}.")
        if steep := steep_note(demo.estimate()):
            console.print(Text(steep, style="yellow"))
    else:
        console.print("The mount was not found.")
    console.print()
    for line in _result_lines(demo, waited):
        console.print(line)
    console.print()
    console.print("Next, with a database and a log of your vehicle:")
    console.print("  imucald init --database car.dbc --out car.yaml drive.log   proposes car.yaml")
    console.print("  imucald check  --config car.yaml drive.log   lists errors in car.yaml")
    console.print("  imucald replay --config car.yaml drive.log   finds the mount")


def _result_table(angles: list[Angle]) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column("mount")
    for name in ("estimate", "± 95 %", "truth", "error"):
        table.add_column(name, justify="right", min_width=9)
    table.add_column("truth inside?")
    for angle in angles:
        style = "green" if angle.inside else "red"
        table.add_row(
            angle.name,
            degrees(angle.estimate),
            interval(angle.std),
            degrees(angle.truth),
            degrees(angle.error),
            Text("yes" if angle.inside else "no", style=style),
        )
    return table


def _result_lines(demo: Demonstration, waited: float | None) -> list[str]:
    pipeline, listener = demo.engine.pipeline, demo.listener
    first, best = pipeline.first_usable, pipeline.first_fine
    name = demo.estimate().state.name.lower()
    usable = "not yet usable" if first is None else when_reached("usable", first)
    fine = "" if best is None else f", fine after {clock(best)}"
    targets = demo.estimate().targets
    if best is None and targets is not None:
        x, y, z = (plus_minus(s * DEG_PER_RAD, 1) for s in targets.fine)
        fine = f"; fine needs ± below {x}, {y}, {z} about the forward, left and up axis"
    took = "" if waited is None else f" in {waited:.0f} s"
    lines = [
        f"{clock(demo.now)} min driven{took}. State {name}: {usable}{fine}.",
        f"{demo.sent} frames received, {demo.engine.router.rejected.total()} rejected; "
        f"{listener.frames} corrected frames came back, {listener.damaged} damaged.",
    ]
    found = demo.compare()
    if found is None:
        return [*lines, "At the end no corrected acceleration was available."]
    return [
        *lines,
        f"Acceleration over the last {min(LAST_S, demo.now):.0f} s, rms distance from the truth:",
        f"  as the sensor sends it    {found.measured:6.2f} m/s²",
        f"  as received from imucald  {found.corrected:6.2f} m/s²",
        f"  with the true mount alone {found.known_mount:6.2f} m/s² (the sensor's own errors stay)",
    ]
