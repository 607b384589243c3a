"""The result of `imucald demo`: estimate and truth, on the terminal and as SVG."""

from __future__ import annotations

import io
import re
from pathlib import Path

from rich._export_format import CONSOLE_SVG_FORMAT
from rich.console import Console
from rich.table import Table
from rich.text import Text

from imucald.commands.demo_drive import LAST_S, Angle, Demonstration, angles_beside
from imucald.commands.demo_picture import Picture, degrees, interval
from imucald.commands.files import with_origin
from imucald.commands.terminal import plain_console
from imucald.core.angles import DEG_PER_RAD
from imucald.core.errors import ImucaldError
from imucald.core.text import clock, when_reached
from imucald.mount.mount_words import (
    CONVENTION,
    how_it_sits,
    plus_minus,
    steep_note,
)

SVG_COLUMNS = 82


def write_svg(demo: Demonstration, picture: Picture, path: Path, command: str) -> None:
    """Write the last picture and the result as SVG. Raises ImucaldError if that fails.

    command: the command line of the demo, for the picture's metadata. The file contains no time of
    the machine, so that the same command writes the same file again.
    """
    console = Console(
        record=True,
        file=io.StringIO(),
        width=SVG_COLUMNS,
        force_terminal=True,
        highlight=False,
        markup=False,
    )
    console.print(picture.draw(demo, steady=False))
    print_result(demo, None, console)
    form = re.sub(r"@font-face \{\{.*?\}\}", "", CONSOLE_SVG_FORMAT, flags=re.DOTALL)
    try:
        svg = console.export_svg(title="imucald demo", code_format=form)
        path.write_text(with_origin(svg, command), "utf-8")
    except OSError as error:
        raise ImucaldError(f"{path}: cannot be written: {error.strerror or error}") from None


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
