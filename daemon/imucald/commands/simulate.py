"""`imucald simulate`: write a simulated drive as a candump log, and its truth to another file."""

from __future__ import annotations

import argparse
import json
import math
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from imucald.commands.options import add_mount, numbers
from imucald.core.errors import ConfigError

if TYPE_CHECKING:
    from imucald.model.model import VehicleModel
    from imucald.simulation.drive import Drive
    from imucald.traffic.drive_encoder import BusEncoder

ROUTES = ("mixed", "city", "motorway", "straight_only", "circles", "parked")
MAX_SCALE = 0.5
"""Largest gain error. No sensor has an error of 50 %. A value near 1 shows that the user stated a
factor instead of an error."""
MAX_MINUTES = 600.0
"""Longest drive [min]. A drive of ten hours needs about 1.5 GB of memory."""


LATEST_START_S = 4_102_444_800.0
"""Latest start of a drive: 1 January 2100 [UNIX s]."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `simulate`."""
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE.log",
        help="log to write ('-': standard output). The true values are written to FILE.truth.json",
    )
    parser.add_argument(
        "--minutes", type=float, default=10.0, help="length of the drive [min] (default: 10)"
    )
    parser.add_argument(
        "--start",
        metavar="TIME",
        help="date and time of the log's first frame, such as 2026-05-01T08:00 (UTC, or with an "
        "offset; default: 2020-09-13T12:26:40)",
    )
    parser.add_argument("--seed", type=int, default=1, help="the same seed gives the same drive")
    add_mount(parser)
    parser.add_argument(
        "--shift",
        action="append",
        default=[],
        metavar="T,R,P,Y",
        help="turn the sensor by these degrees at T seconds of the drive; may be repeated",
    )
    parser.add_argument("--route", choices=ROUTES, metavar="KIND",
                        help=f"kind of route: {', '.join(ROUTES)} (default: mixed)")  # fmt: skip
    parser.add_argument(
        "--model",
        type=Path,
        metavar="FILE",
        help="model file; without it, vehicle, road and sensor are drawn from the seed",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        dest="changes",
        help="change a parameter of the model, for example road.crown_mean=0.02 or "
        "suspension.body_roll=false; may be repeated",
    )
    parser.add_argument(
        "--config",
        type=Path,
        metavar="FILE",
        help="configuration whose messages are written (default: an example bus)",
    )
    parser.add_argument(
        "--background",
        action=argparse.BooleanOptionalAction,
        default=False,
        help="write the frames of other control units too, about 2300/s",
    )
    parser.add_argument("--interface", help="python-can interface of the bus that gets the drive")
    parser.add_argument("--channel", help="channel of this interface, such as vcan0")
    parser.add_argument(
        "--speed",
        type=float,
        default=1.0,
        help="with --interface: how many times as fast as real time (default: 1). A listening "
        "daemon uses real time: it finds the mount only with 1",
    )
    parser.add_argument(
        "--write-model",
        type=Path,
        metavar="FILE",
        help="write the model that was used, with every parameter",
    )


def run(options: argparse.Namespace) -> int:
    """Simulate a drive. Write log, truth and (if requested) the model file, and print the names of
    the written files."""
    from imucald.commands.files import check_files, write_yaml
    from imucald.commands.schema import MODEL
    from imucald.config import load_config
    from imucald.simulation.drive import simulate
    from imucald.traffic.drive_encoder import BusEncoder, example_config

    if not 0.0 < options.minutes <= MAX_MINUTES:
        raise ConfigError(f"--minutes must be above 0 and not above {MAX_MINUTES:g}")
    if options.out is None and options.interface is None:
        raise ConfigError("say where the frames go: --out FILE.log, or --interface and --channel")
    if (options.interface is None) != (options.channel is None):
        raise ConfigError("give --interface and --channel together, or neither")
    if not 0.0 < options.speed < 1e6:
        raise ConfigError("--speed must be positive")
    inputs = [name for name in (options.config, options.model) if name]
    check_files(inputs, (options.out, _truth_beside(options.out), options.write_model))
    config = load_config(options.config) if options.config else example_config()
    model = chosen_model(options, config.config.vehicle.driving_side if options.config else None)
    latest = max((_numbers("--shift", text, 4)[0] for text in options.shift or ()), default=0.0)
    if latest >= 60.0 * options.minutes:
        text = f"the drive ends after {60.0 * options.minutes:g} s"
        raise ConfigError(
            f"--shift at {latest:g} s: {text}; give more --minutes, or an earlier time"
        )
    start_s = _start(options.start)
    encoder = BusEncoder(config)
    drive = simulate(model, options.seed, options.minutes)
    if options.out is not None:
        _write_log(options, drive, encoder, start_s)
    if options.write_model:
        write_yaml(options.write_model, model.to_yaml(), MODEL)
    for name in encoder.left_out:
        why = "an expression or a sign in another message defines it"
        print(f"{name} is not written into the log: {why}", file=sys.stderr)
    if options.interface is not None:
        _send(options, drive, encoder)
    return 0


def _start(text: str | None) -> float:
    from imucald.traffic.can_log import EPOCH_S

    if text is None:
        return EPOCH_S
    try:
        time = datetime.fromisoformat(text)
    except ValueError:
        raise ConfigError(f"--start {text!r}: no date such as 2026-05-01T08:00") from None
    start = (time if time.tzinfo else time.replace(tzinfo=UTC)).timestamp()
    if not 0.0 <= start < LATEST_START_S:
        raise ConfigError(f"--start {text!r}: must be between 1970 and 2100")
    return start


def _write_log(
    options: argparse.Namespace, drive: Drive, encoder: BusEncoder, start_s: float
) -> None:
    from imucald.commands.files import reported_when_cut, write_text
    from imucald.commands.terminal import countdown
    from imucald.traffic.can_log import write_log

    with countdown("writing", drive.duration_s) as progress, reported_when_cut(options.out):
        frames = write_log(drive, options.out, encoder, options.background, progress, start_s)
    truth = _truth_beside(options.out)
    if truth is None:
        return
    write_text(truth, json.dumps(drive.summary(), indent=2) + "\n")
    print(_report(options.out, truth, drive, frames))


def _truth_beside(log: Path | None) -> Path | None:
    if log is None or str(log) == "-":
        return None
    return log.with_name(f"{log.name.removesuffix('.gz').removesuffix('.log')}.truth.json")


def _send(options: argparse.Namespace, drive: Drive, encoder: BusEncoder) -> None:
    from imucald.can.link.link import Link
    from imucald.commands.terminal import countdown
    from imucald.traffic.can_log import play

    with (
        Link(options.interface, options.channel, receive=()) as link,
        countdown("driving", drive.duration_s) as progress,
    ):
        frames = play(drive, encoder, link, options.speed, options.background, progress)
    print(f"{options.channel}: {frames} frames sent")


def chosen_model(options: argparse.Namespace, side: str | None = None) -> VehicleModel:
    """Return the model that the options select (from a file or random), with the given changes.

    side: driving side in the configuration. A driving side from `--set` or a model file takes
    precedence.
    """
    from imucald.model.model import load_model
    from imucald.simulation.random_model import random_model

    if options.model:
        model = load_model(options.model)
    else:
        model = random_model(options.seed, options.route or "mixed")
    asked = dict(_change(text) for text in options.changes)
    changes: dict[str, Any] = {}
    if side in ("left", "right") and _SIDE not in asked:
        changes[_SIDE] = _side(options, model, side)
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
    changes |= asked
    model = model.with_changes(changes) if changes else model
    _check_scales(model)
    return model


def _check_scales(model: VehicleModel) -> None:
    """Raise ConfigError for a gain error that looks like a factor."""
    for section, values in model.dump().items():
        scale = values.get("scale", 0.0) if isinstance(values, dict) else 0.0
        for x in scale if isinstance(scale, (list, tuple)) else (scale,):
            if abs(x) > MAX_SCALE:
                raise ConfigError(
                    f"{section}.scale is {x:g}: this key is a relative error. 0 means no error, "
                    f"0.04 means values that are 4 % too large, and {MAX_SCALE:g} is the largest "
                    "error"
                )


def _side(options: argparse.Namespace, model: VehicleModel, side: str) -> str:
    """Return the driving side: the model file's if it states one, else the configuration's."""
    from imucald.core.yaml_lines import read_yaml_file

    if not options.model:
        return side
    data, _ = read_yaml_file(options.model, "model file")
    section, key = _SIDE.split(".")
    if key not in ((data or {}).get(section) or {}):
        return side
    stated = model.route.driving_side
    if stated != side:
        print(
            f"imucald: warning: {options.model} drives on the {stated}, but {options.config} "
            f"states 'driving_side: {side}'; the model file is used",
            file=sys.stderr,
        )
    return stated


_SIDE = "route.driving_side"
_ANGLES = ("roll_deg", "pitch_deg", "yaw_deg")


def _numbers(option: str, text: str, count: int) -> list[float]:
    found = numbers(text)
    if len(found) != count:
        raise ConfigError(f"{option} {text!r}: write {count} numbers with commas between them")
    return found


def _change(text: str) -> tuple[str, Any]:
    from imucald.core.yaml_lines import read_yaml

    key, equals, value = text.partition("=")
    if not equals:
        raise ConfigError(f"--set {text!r}: write KEY=VALUE")
    return key.strip(), read_yaml(value, f"--set {key}")[0]


def _report(log: Path, truth: Path, drive: Drive, frames: int) -> str:
    from imucald.core.rotations import angles_from_rotation

    angles = angles_from_rotation(drive.truth.mounts[0][1])
    roll, pitch, yaw = (f"{math.degrees(angle):.2f}" for angle in angles)
    summary = drive.truth.summary()
    lines = [
        f"{log}: {frames} frames, {drive.duration_s:.0f} s, {summary['distance_m']:.0f} m driven",
        f"{truth}: mount roll {roll}, pitch {pitch}, yaw {yaw} deg",
    ]
    return "\n".join(lines)
