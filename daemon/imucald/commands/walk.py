"""`imucald walk`: direction of travel of a carried terminal, from a recorded log."""

from __future__ import annotations

import argparse
import math
import sys
from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from imucald.commands.options import add_config

if TYPE_CHECKING:
    from imucald.can.logs.log_reader import LogReader
    from imucald.config import LoadedConfig
    from imucald.inputs.router import Router
    from imucald.travel_direction.direction import Step, TravelDirection

SHOWN = 20
"""Lines of the table: steps are left out until it fits a page."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `walk`."""
    parser.add_argument(
        "logs", nargs="+", metavar="LOG", help="as for replay; '-' is standard input"
    )
    add_config(parser)
    parser.add_argument(
        "--json",
        nargs="?",
        const="-",
        metavar="FILE",
        help="write every step as JSON (without FILE: standard output)",
    )
    parser.add_argument("--strict", action="store_true", help="stop at the first bad line")
    parser.add_argument("--quiet", action="store_true", help="no progress, no table")


def run(options: argparse.Namespace) -> int:
    """Read the log, step by step."""
    from imucald.can.logs.log_reader import LogReader
    from imucald.commands.files import STANDARD, check_files, write_text
    from imucald.commands.terminal import progress_bar
    from imucald.inputs.wiring import compile_router
    from imucald.runtime.session import open_config
    from imucald.runtime.summary import as_json
    from imucald.travel_direction.direction import TravelDirection

    check_files((options.config, *options.database, *options.logs), (options.json,))
    loaded = open_config(options.config, options.database)
    _need_compass(loaded)
    router = compile_router(loaded)
    travel = TravelDirection(loaded.config.travel_direction)
    with progress_bar("walk", options.quiet) as progress:
        reader = LogReader(options.logs, router.matches, options.strict, progress)
        steps = _steps(reader, router, travel)
    for text in reader.problems:
        print(f"imucald: {text}", file=sys.stderr)
    result = _result(steps, travel, reader, router)
    if options.json:
        write_text(options.json, as_json(result))
    if options.json != STANDARD and not options.quiet:
        _table(steps, result)
    return 0


def _need_compass(loaded: LoadedConfig) -> None:
    signals = loaded.config.signals
    if signals.magnetometer is None and signals.heading is None:
        raise loaded.error(("signals",), "walk needs a magnetometer or a heading")


def _steps(reader: LogReader, router: Router, travel: TravelDirection) -> list[Step]:
    from imucald.runtime.consumer import events_of
    from imucald.runtime.consumers import TravelConsumer
    from imucald.runtime.timebase import TimeBase

    timebase = TimeBase()
    steps: list[Step] = []
    channels = TravelConsumer.channels
    for chunk in reader:
        for segment in timebase.segments(chunk.t):
            if segment.gap:
                travel.gap()
            part = chunk.take(slice(segment.start, segment.stop))
            samples = router.columns(segment.t, part).samples
            for _, t, channel, values in events_of(samples, channels):
                step = travel.sample(t, channel, values)
                if step is not None:
                    steps.append(step)
    return steps


def _degrees(angle: float | None) -> float | None:
    return None if angle is None else round(math.degrees(angle), 2)


def _result(
    steps: Sequence[Step], travel: TravelDirection, reader: LogReader, router: Router
) -> dict[str, Any]:
    """Content of the JSON, as docs/json.md has it."""
    rejected = router.rejected + Counter(reader.rejected)
    return {
        "steps": travel.steps,
        "cadence_hz": _cadence(steps),
        "method": travel.settings.method,
        "frames": {
            "read": reader.frames_read,
            "used": router.used,
            "rejected": dict(sorted(rejected.items())),
        },
        "track": [_step(step) for step in steps],
    }


def _cadence(steps: Sequence[Step]) -> float | None:
    times = sorted(step.duration for step in steps)
    return round(1.0 / times[len(times) // 2], 3) if times else None


def _step(step: Step) -> dict[str, Any]:
    published = step.published
    found: dict[str, Any] = {
        "t_s": round(step.t, 3),
        "heading_deg": _degrees(step.heading),
        "compass_deg": _degrees(step.compass),
        "alternative_deg": _degrees(step.alternative),
        "published_deg": None,
        "deviation_deg": _degrees(step.deviation),
        "ahead_probability": None if step.ahead is None else round(step.ahead, 4),
        "ambiguous": step.ambiguous,
    }
    if published is not None:
        found.update(
            published_deg=_degrees(published.heading),
            tilt_deg=_degrees(published.tilt_heading),
            correlation_deg=_degrees(published.correlation_heading),
            chosen="tilt" if published.used_tilt else "correlation",
            turn=published.is_turn,
        )
    return found


def _table(steps: Sequence[Step], result: dict[str, Any]) -> None:
    from rich.table import Table

    from imucald.commands.terminal import plain_console, plain_where_needed
    from imucald.mount.mount_words import CONVENTION, plus_minus

    plain_where_needed()
    table = Table(box=None, pad_edge=False)
    for name in ("time s", "heading", "± 95 %", "compass", "alternative", "published", "chosen"):
        table.add_column(name, justify="right")
    every = max(1, math.ceil(len(steps) / SHOWN))
    for step in result["track"][::every]:
        keys = ("heading_deg", "compass_deg", "alternative_deg", "published_deg")
        cells = ["-" if step[k] is None else f"{step[k]:.0f}" for k in keys]
        if step["ambiguous"]:
            cells[0] = f"{cells[0]} or opposite"
        cells.insert(1, plus_minus(step["deviation_deg"], 0, unit=""))
        table.add_row(f"{step['t_s']:.1f}", *cells, str(step.get("chosen", "-")))
    print(f"{result['steps']} steps; heading [deg from north] by the {result['method']} method")
    if every > 1:
        print(f"the table has every {every}th step; --json has all")
    console = plain_console()
    console.print(table)
    console.print(CONVENTION)
