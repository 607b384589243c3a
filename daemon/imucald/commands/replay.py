"""`imucald replay`: recorded logs through the same engine as the live daemon."""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from imucald.commands.options import LOG_HELP, add_config

if TYPE_CHECKING:
    from imucald.can.columns import FrameColumns
    from imucald.config import LoadedConfig
    from imucald.runtime.replay import Sink


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `replay`."""
    parser.add_argument(
        "logs",
        nargs="+",
        metavar="LOG",
        help=LOG_HELP,
    )
    add_config(parser)
    parser.add_argument(
        "--out", metavar="FILE", help="write the frames that imucald would send (candump log)"
    )
    parser.add_argument(
        "--json", metavar="FILE", help="write the result as JSON ('-': standard output)"
    )
    parser.add_argument(
        "--report",
        type=Path,
        metavar="DIR",
        help="write a page about the drive here (needs pip install 'imucald[report]')",
    )
    parser.add_argument("--strict", action="store_true", help="stop at the first bad line")
    parser.add_argument(
        "--speed",
        type=float,
        metavar="X",
        help="play at X times real time and send the frames on the bus (1 is real time)",
    )
    parser.add_argument("--interface", help="with --speed: python-can interface of that bus")
    parser.add_argument("--channel", help="with --speed: its channel")
    parser.add_argument("--quiet", action="store_true", help="no progress, no table")


def run(options: argparse.Namespace) -> int:
    """Replay, then say what came of it."""
    from imucald.can.logs.log_reader import LogReader
    from imucald.commands.files import STANDARD, write_text
    from imucald.commands.terminal import progress_bar
    from imucald.core.errors import LogError
    from imucald.core.file_cache import keep_databases
    from imucald.runtime.replay import Replay
    from imucald.runtime.session import make_engine, open_config
    from imucald.runtime.summary import as_json

    _check(options)
    keep_databases(os.environ)
    loaded = open_config(options.config, options.database)
    page = None
    if options.report:
        from imucald.commands.replay_report import ReplayReport

        page = ReplayReport(loaded, options)
    engine = make_engine(loaded, page and page.history.snapshot)
    with progress_bar("replay", options.quiet) as progress, _sink(options, loaded) as sink:
        new_reader = LogReader if page is None else page.reader
        reader = new_reader(options.logs, engine.router.matches, options.strict, progress)
        taker = sink if page is None else page.sink(engine, sink)
        result = Replay(engine, reader, taker, options.speed).run()
    for text in reader.problems:
        print(f"imucald: {text}", file=sys.stderr)
    for text in (
        engine.preprocessing.notes if engine.preprocessing is not None and not options.quiet else ()
    ):
        print(f"imucald: not used of the model: {text}", file=sys.stderr)
    if options.json:
        write_text(options.json, as_json(result))
    if reader.frames_read == 0:
        raise LogError(f"{', '.join(options.logs)}: holds no CAN frame")
    if engine.router.used == 0:
        text = "the log has no usable frame of this configuration; 'imucald check' tells more"
        print(f"imucald: {text}", file=sys.stderr)
    if page is not None:
        page.write(result, reader.problems)
    if STANDARD not in (options.json, options.out) and not options.quiet:
        from imucald.commands.terminal import print_summary

        print_summary(result)
    return 0


def _check(options: argparse.Namespace) -> None:
    """Raise ImucaldError for options that do not go together, before any work."""
    from imucald.commands.files import check_files
    from imucald.core.errors import ConfigError

    if options.speed is None:
        if options.interface or options.channel:
            raise ConfigError("--interface and --channel need --speed (1 is real time)")
    elif not (options.speed > 0 and math.isfinite(options.speed)):
        raise ConfigError("--speed must be positive")
    inputs = (options.config, *options.database, *options.logs)
    check_files(inputs, (options.out, options.json))


@contextmanager
def _sink(options: argparse.Namespace, loaded: LoadedConfig) -> Iterator[Sink | None]:
    """Where the frames go: a file, a bus, both, or nowhere (None)."""
    from contextlib import ExitStack

    from imucald.can.logs.log_reader import CandumpWriter
    from imucald.commands.files import told_when_cut

    with ExitStack() as stack:
        sinks: list[Sink] = []
        if options.out:
            writer = stack.enter_context(CandumpWriter(options.out))
            stack.enter_context(told_when_cut(options.out))
            sinks.append(writer.write_columns)
        if options.speed is not None:
            from imucald.service.live import open_link, send_columns

            link = stack.enter_context(
                open_link(loaded, [], frozenset(), options.interface, options.channel)
            )
            sinks.append(lambda frames: send_columns(link, frames))

        def everywhere(frames: FrameColumns) -> None:
            for sink in sinks:
                sink(frames)

        yield everywhere if sinks else None
