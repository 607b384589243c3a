"""`imucald walk`: find the direction of travel of a carried terminal from a recorded log."""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping
from typing import Any

from imucald.commands.options import (
    LOG_HELP,
    add_config,
    add_quiet,
    add_strict,
    configuration,
    print_problems,
)
from imucald.core.text import counted


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `walk`."""
    parser.add_argument("logs", nargs="+", metavar="LOG", help=LOG_HELP)
    add_config(parser)
    parser.add_argument(
        "--json",
        nargs="?",
        const="-",
        metavar="FILE",
        help="write every step as JSON (without FILE: standard output)",
    )
    add_strict(parser)
    add_quiet(parser, "print no progress and no table")


def run(options: argparse.Namespace) -> int:
    """Read the log, and print the steps."""
    from imucald.api.walking import walk
    from imucald.commands.files import STANDARD, check_files, write_text
    from imucald.commands.terminal import progress_bar
    from imucald.runtime.summary import as_json

    check_files((options.config, *options.database, *options.logs), (options.json,))
    config = configuration(options)
    with progress_bar("walk", options.quiet) as progress:
        found = walk(config, options.logs, progress=progress, strict=options.strict)
    print_problems(found.problems)
    result = found.to_dict()
    if options.json:
        write_text(options.json, as_json(result))
    if options.json != STANDARD and not options.quiet:
        _table(result)
    return 0


def _table(result: Mapping[str, Any]) -> None:
    from rich.table import Table

    from imucald.commands.terminal import plain_console, plain_where_needed
    from imucald.mount.mount_words import CONVENTION, plus_minus

    plain_where_needed()
    table = Table(box=None, pad_edge=False)
    for name in ("time s", "heading", "± 95 %", "compass", "alternative", "published", "chosen"):
        table.add_column(name, justify="right")
    every = max(1, math.ceil(len(result["track"]) / 20))
    for step in result["track"][::every]:
        keys = ("heading_deg", "compass_deg", "alternative_deg", "published_deg")
        cells = ["-" if step[k] is None else f"{step[k]:.0f}" for k in keys]
        if step["ambiguous"]:
            cells[0] = f"{cells[0]} or opposite"
        cells.insert(1, plus_minus(step["deviation_deg"], 0, unit=""))
        table.add_row(f"{step['t_s']:.1f}", *cells, str(step.get("chosen", "-")))
    steps = counted(result["steps"], "step")
    print(f"{steps}; heading [deg from north] by the {result['method']} method")
    if every > 1:
        print(f"the table shows every {every}th step; --json writes all steps")
    console = plain_console()
    console.print(table)
    console.print(CONVENTION)
