"""`imucald simulate`: a simulated drive as a candump log, with its truth beside it."""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from imucald.errors import ConfigError, ImucaldError

if TYPE_CHECKING:
    from imucald.simulation.can_log import Progress
    from imucald.simulation.drive import Drive
    from imucald.simulation.model import Model

ROUTES = ("mixed", "city", "motorway", "straight_only", "circles", "parked")
MAX_MINUTES = 600.0
"""Ten hours: about 1.5 GB of memory."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `simulate`."""
    # Otherwise "-5,3,30" would be taken for an option.
    parser._negative_number_matcher = re.compile(r"^-[\d.][\d.,e+-]*$")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.log",
                        help="the log; truth.json is written beside it")  # fmt: skip
    parser.add_argument("--minutes", type=float, default=10.0, help="length (default: 10)")
    parser.add_argument("--seed", type=int, default=1, help="the same seed gives the same drive")
    parser.add_argument("--mount", metavar="R,P,Y",
                        help="mount angles in degrees (default: drawn from the seed)")  # fmt: skip
    parser.add_argument("--shift", action="append", default=[], metavar="T,R,P,Y",
                        help="turn the sensor by these degrees, T seconds into the drive; "
                        "may be repeated")  # fmt: skip
    parser.add_argument("--route", choices=ROUTES, help="kind of route (default: mixed)")
    parser.add_argument("--model", type=Path, metavar="FILE",
                        help="model file; without it, vehicle, road and sensor are drawn "
                        "from the seed")  # fmt: skip
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="changes",
                        help="change a parameter of the model, as road.crown_mean=0.02 or "
                        "suspension.body_roll=false; may be repeated")  # fmt: skip
    parser.add_argument("--config", type=Path, metavar="FILE",
                        help="configuration whose messages are written (default: an example "
                        "bus)")  # fmt: skip
    parser.add_argument("--background", action=argparse.BooleanOptionalAction, default=False,
                        help="write the frames of other units too, about 2300/s")  # fmt: skip
    parser.add_argument("--write-model", type=Path, metavar="FILE",
                        help="write the model that was used, every parameter")  # fmt: skip


def run(options: argparse.Namespace) -> int:
    """Simulate, write log, truth and perhaps the model; say what was written."""
    from imucald.config import load_config
    from imucald.simulation.bus_frames import BusEncoder, example_config
    from imucald.simulation.can_log import write_log
    from imucald.simulation.drive import simulate

    if not 0.0 < options.minutes <= MAX_MINUTES:
        raise ConfigError(f"--minutes must be between 0 and {MAX_MINUTES:g}")
    model = chosen_model(options)
    loaded = load_config(options.config) if options.config else example_config()
    encoder = BusEncoder(loaded)
    with _progress() as progress:
        drive = simulate(model, options.seed, options.minutes)
        frames = write_log(drive, options.out, encoder, options.background, progress)
    truth = options.out.parent / "truth.json"
    _write(truth, json.dumps(drive.summary(), indent=2) + "\n")
    if options.write_model:
        _write(options.write_model, model.to_yaml())
    print(_report(options.out, truth, drive, frames))
    for name in encoder.left_out:
        print(f"not written, as it comes by an expression: {name}", file=sys.stderr)
    return 0


def chosen_model(options: argparse.Namespace) -> Model:
    """Return the model that the options ask for: file or drawn, then changed."""
    from imucald.simulation.model import load_model
    from imucald.simulation.random_model import random_model

    if options.model:
        model = load_model(options.model)
    else:
        model = random_model(options.seed, options.route or "mixed")
    changes: dict[str, Any] = {}
    if options.model and options.route:
        changes["route.kind"] = options.route
    if options.mount:
        angles = _numbers("--mount", options.mount, 3)
        changes |= dict(zip(_ANGLES, angles, strict=True))
        changes = {f"mount.{k}" if k in _ANGLES else k: v for k, v in changes.items()}
    if options.shift:
        keys = ("t_s", *_ANGLES)
        shifts = [_numbers("--shift", text, 4) for text in options.shift]
        shifts.sort()
        changes["mount.shifts"] = [dict(zip(keys, shift, strict=True)) for shift in shifts]
    changes |= dict(_change(text) for text in options.changes)
    return model.with_changes(changes) if changes else model


_ANGLES = ("roll_deg", "pitch_deg", "yaw_deg")


def _numbers(option: str, text: str, count: int) -> list[float]:
    parts = text.split(",")
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        numbers = []
    if len(numbers) != count:
        raise ConfigError(f"{option} {text!r}: {count} numbers with commas between are needed")
    return numbers


def _change(text: str) -> tuple[str, Any]:
    from imucald.config import read_yaml

    key, equals, value = text.partition("=")
    if not equals:
        raise ConfigError(f"--set {text!r}: the form is KEY=VALUE")
    return key.strip(), read_yaml(value, f"--set {key}")[0]


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ImucaldError(f"{path}: cannot be written: {error.strerror or error}") from None


def _report(log: Path, truth: Path, drive: Drive, frames: int) -> str:
    from imucald.frames import angles_from_rotation

    angles = angles_from_rotation(drive.truth.mounts[0][1])
    roll, pitch, yaw = (f"{57.29577951308232 * angle:.2f}" for angle in angles)
    summary = drive.truth.summary()
    lines = [
        f"{log}: {frames} frames, {drive.duration_s:.0f} s, {summary['distance_m']:.0f} m driven",
        f"{truth}: mount roll {roll}, pitch {pitch}, yaw {yaw} deg",
    ]
    return "\n".join(lines)


@contextmanager
def _progress() -> Iterator[Progress | None]:
    """Show a bar on a terminal; nothing elsewhere."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("driving", total=None)

        def show(done_s: float, total_s: float) -> None:
            bar.update(task, description="writing", completed=done_s, total=total_s)

        yield show
