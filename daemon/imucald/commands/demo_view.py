"""What `imucald demo` shows: a live picture on a terminal, lines elsewhere, then the result."""

from __future__ import annotations

import io
import math
import re
import time
from pathlib import Path
from types import TracebackType
from typing import Self

from rich._export_format import CONSOLE_SVG_FORMAT
from rich.console import Console, Group
from rich.live import Live
from rich.padding import Padding
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from imucald.commands.demo_drive import LAST_S, Angle, Demonstration, angles_beside
from imucald.commands.terminal import plain_console
from imucald.core.angles import DEG_PER_RAD
from imucald.core.errors import ImucaldError
from imucald.core.rotations import angles_from_rotation
from imucald.mount.estimate import ANGLES, MountState
from imucald.mount.mount_words import (
    AXES,
    CONVENTION,
    SD_95,
    how_it_sits,
    plus_minus,
    reasons,
    steep_note,
)

FASTEST = 24.0
"""On a terminal no more times real time than this, so that the eye can follow."""
FRAME_S = 0.1
"""The picture is drawn anew so often [s of waiting]."""
LINE_S = 15.0
"""A plain line appears so often [s of driving]."""
HISTORY = 24
"""Columns of the history of an angle's uncertainty."""
SVG_COLUMNS = 82
BLOCKS = " ▁▂▃▄▅▆▇█"
WIDEST_DEG, NARROWEST_DEG = 12.0, 0.25
"""95 % intervals that fill the history's column, and that leave it empty (log scale)."""
_STYLES = {
    MountState.USABLE: "green",
    MountState.FINE: "bold green",
    MountState.SUSPECT: "red",
    MountState.RECALIBRATING: "red",
}


class PlainView:
    """One line every so often."""

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._next = LINE_S

    def __enter__(self) -> Self:
        print(f"A simulated drive (seed {self._seed}) on a virtual CAN bus, imucald listening.")
        print(
            "   time  state             roll 95 %        pitch 95 %          yaw 95 %  waiting for"
        )
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Nothing is open."""

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
        print(f"{_clock(demo.now):>7}  {state:<9}{cells}  {waiting}".rstrip(), flush=True)


class LiveView:
    """A picture that moves."""

    def __init__(self, seed: int) -> None:
        self._live = Live(console=plain_console(), auto_refresh=False, transient=True)
        self._picture = Picture()
        self._began = time.monotonic()
        self._drawn = -math.inf

    def __enter__(self) -> Self:
        self._live.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._live.__exit__(kind, error, trace)

    def show(self, demo: Demonstration) -> None:
        """Draw the picture when it is due."""
        self._picture.note(demo)
        now = time.monotonic()
        ahead = demo.now / FASTEST - (now - self._began)
        if ahead > 0.0:
            time.sleep(ahead)
        if now - self._drawn >= FRAME_S or demo.now >= demo.drive.duration_s:
            self._drawn = now
            self._live.update(self._picture.draw(demo), refresh=True)


class Picture:
    """The state of a demonstration at one moment, with the history of its uncertainty."""

    def __init__(self) -> None:
        self._began = time.monotonic()
        self._history: dict[str, list[float]] = {name: [] for name in ANGLES}

    def note(self, demo: Demonstration) -> None:
        """Take the uncertainty of the moment into the history."""
        columns = min(int(HISTORY * demo.now / demo.drive.duration_s), HISTORY)
        if columns <= len(self._history["yaw"]):
            return
        angles = {a.name: a for a in angles_beside(demo.estimate(), demo.truth)}
        for name, history in self._history.items():
            width = SD_95 * angles[name].std if name in angles else math.inf
            history.extend([width] * (columns - len(history)))

    def draw(self, demo: Demonstration, steady: bool = True) -> Group:
        """Return the picture, twenty lines for 80 columns; steady: of the same height always."""
        estimate = demo.estimate()
        waiting = [f"waiting for  {who}: {text}" for who, text in reasons(estimate.waiting_for)]
        if steady:
            waiting += [""] * (len(ANGLES) - len(waiting))
        return Group(
            _headline(demo),
            Padding(_state_line(demo), (1, 0)),
            self._angle_table(demo),
            Padding(
                Text("\n".join(waiting), style="yellow", overflow="ellipsis", no_wrap=True),
                (1, 0, 0, 0),
            ),
            Padding(_acceleration_table(demo), (1, 0)),
            _traffic_line(demo, time.monotonic() - self._began),
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
            cells = ("-", "-") if found is None else (_deg(found.estimate), _interval(found.std))
            history = Text(_history(self._history[name]), style="cyan")
            table.add_row(name, *cells, _deg(truth[name]), history)
        return table


def _headline(demo: Demonstration) -> Table:
    grid = Table.grid(padding=(0, 2))
    speed, _, yaw_rate = demo.motion()
    turn = "left" if yaw_rate > 0.03 else "right" if yaw_rate < -0.03 else "straight on"
    doing = "standing" if abs(speed) < 0.1 else f"{3.6 * speed:3.0f} km/h, {turn}"
    grid.add_row(
        Text("imucald demo", style="bold"),
        ProgressBar(demo.drive.duration_s, min(demo.now, demo.drive.duration_s), width=24),
        f"{_clock(demo.now)} of {_clock(demo.drive.duration_s)}",
        doing,
    )
    return grid


def _state_line(demo: Demonstration) -> Text:
    estimate, pipeline = demo.estimate(), demo.engine.pipeline
    text = Text("state  ")
    text.append(estimate.state.name.lower(), style=_STYLES.get(estimate.state, "yellow"))
    times = (("usable", pipeline.first_usable), ("fine", pipeline.first_fine))
    reached = [f"{name} after {_clock(t)}" for name, t in times if t is not None]
    text.append("   " + ", ".join(reached) if reached else "   nothing is sent as available yet")
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


def _traffic_line(demo: Demonstration, waited: float) -> Text:
    now = max(demo.now, 1e-9)
    rejected = demo.engine.router.rejected.total()
    text = f"{demo.sent / now:.0f} frames/s in, {demo.engine.sent / now:.0f}/s out"
    text += f", {rejected} rejected, {now / max(waited, 1e-9):.0f} times real time"
    return Text(text, style="dim")


def write_svg(demo: Demonstration, picture: Picture, waited: float, path: Path) -> None:
    """Write the last picture and the result as SVG. Raises ImucaldError where it cannot."""
    console = Console(
        record=True,
        file=io.StringIO(),
        width=SVG_COLUMNS,
        force_terminal=True,
        highlight=False,
        markup=False,
    )
    console.print(picture.draw(demo, steady=False))
    print_result(demo, waited, console)
    form = re.sub(r"@font-face \{\{.*?\}\}", "", CONSOLE_SVG_FORMAT, flags=re.DOTALL)
    try:
        path.write_text(console.export_svg(title="imucald demo", code_format=form), "utf-8")
    except OSError as error:
        raise ImucaldError(f"{path}: cannot be written: {error.strerror or error}") from None


def print_result(demo: Demonstration, waited: float, console: Console | None = None) -> None:
    """Print estimate beside truth, the frames' proof, and what to do next."""
    console = console or plain_console()
    angles = angles_beside(demo.estimate(), demo.truth)
    console.print()
    if angles:
        console.print(_result_table(angles))
        console.print(Text(f"{CONVENTION}; it and the error: {AXES}", style="dim"))
        if sits := how_it_sits(demo.estimate()):
            console.print(f"The sensor: {sits}.")
        if steep := steep_note(demo.estimate()):
            console.print(Text(steep, style="yellow"))
    else:
        console.print("No estimate was reached.")
    console.print()
    for line in _result_lines(demo, waited):
        console.print(line)
    console.print()
    console.print("Next, on a log of your vehicle (config/imucald.yaml is a commented start):")
    console.print("  imucald check  --config car.yaml drive.log   what it decodes, what is odd")
    console.print("  imucald replay --config car.yaml drive.log   what it finds")


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
            _deg(angle.estimate),
            _interval(angle.std),
            _deg(angle.truth),
            _deg(angle.error),
            Text("yes" if angle.inside else "no", style=style),
        )
    return table


def _result_lines(demo: Demonstration, waited: float) -> list[str]:
    pipeline, listener = demo.engine.pipeline, demo.listener
    first, best = pipeline.first_usable, pipeline.first_fine
    name = demo.estimate().state.name.lower()
    usable = "not yet usable" if first is None else f"usable after {_clock(first)}"
    fine = "" if best is None else f", fine after {_clock(best)}"
    targets = demo.estimate().targets
    if best is None and targets is not None:
        roll, pitch, yaw = (plus_minus(s * DEG_PER_RAD, 1) for s in targets.fine)
        fine = f" (fine below roll {roll}, pitch {pitch}, yaw {yaw})"
    lines = [
        f"State {name}: {usable}{fine} of {_clock(demo.now)} driven, in {waited:.0f} s.",
        f"{demo.sent} frames received, {demo.engine.router.rejected.total()} rejected; "
        f"{listener.frames} corrected ones heard, {listener.damaged} damaged.",
    ]
    found = demo.compare()
    if found is None:
        return [*lines, "No corrected acceleration was available in the end."]
    return [
        *lines,
        f"Acceleration over the last {min(LAST_S, demo.now):.0f} s, rms distance from the truth:",
        f"  as the sensor sends it    {found.measured:6.2f} m/s²",
        f"  as received from imucald  {found.corrected:6.2f} m/s²",
        f"  with the mount known      {found.known_mount:6.2f} m/s² (noise, vibration, bias)",
    ]


def _with_interval(angle: Angle | None) -> str:
    if angle is None:
        return "-"
    return f"{angle.estimate * DEG_PER_RAD:+.2f} {plus_minus(angle.std * DEG_PER_RAD, unit='')}"


def _deg(angle: float) -> str:
    return f"{angle * DEG_PER_RAD:+.2f}°"


def _interval(std: float) -> str:
    return plus_minus(std * DEG_PER_RAD)


def _history(widths: list[float]) -> str:
    return "".join(_block(w * DEG_PER_RAD) for w in widths)


def _block(width_deg: float) -> str:
    if not math.isfinite(width_deg):
        return "·"
    span = math.log(WIDEST_DEG / NARROWEST_DEG)
    part = math.log(max(width_deg, NARROWEST_DEG) / NARROWEST_DEG) / span
    return BLOCKS[min(max(math.ceil(part * 8.0), 1), 8)]


def _clock(seconds: float) -> str:
    whole = round(seconds)
    return f"{whole // 60}:{whole % 60:02d}"
