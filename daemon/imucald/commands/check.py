"""`imucald check`: what a configuration would decode, from a log or a live bus."""

from __future__ import annotations

import argparse
import json
import sys
from typing import TYPE_CHECKING

from imucald.commands.options import LOG_HELP, add_bus, add_config

if TYPE_CHECKING:
    from imucald.check import Check
    from imucald.config import LoadedConfig

LISTEN_S = 10.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `check`."""
    parser.epilog = (
        "Without LOG it listens on the configuration's bus; it never sends. Exit status: 0 when "
        "the configuration can be used, 1 when something necessary is missing or wrong."
    )
    parser.add_argument(
        "logs",
        nargs="*",
        metavar="LOG",
        help=LOG_HELP,
    )
    add_config(parser)
    add_bus(parser)
    parser.add_argument(
        "--seconds",
        type=float,
        default=LISTEN_S,
        metavar="S",
        help=f"how long to listen without LOG (default: {LISTEN_S:g})",
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def run(options: argparse.Namespace) -> int:
    """Look, then tell."""
    from imucald.check import Check
    from imucald.commands.files import check_files
    from imucald.core.errors import ConfigError
    from imucald.runtime.session import open_config

    if options.logs and (options.interface or options.channel):
        raise ConfigError("either LOG or --interface and --channel: not both")
    if not options.seconds > 0:
        raise ConfigError("--seconds must be positive")
    check_files((options.config, *options.database, *options.logs), ())
    loaded = open_config(options.config, options.database)
    check = Check(loaded)
    if options.logs:
        _read(check, options.logs)
    else:
        _listen(check, loaded, options)
    report = check.report()
    if options.json:
        json.dump(report, sys.stdout, indent=2, allow_nan=False, ensure_ascii=False)
        print()
    else:
        from imucald.commands.check_view import print_report
        from imucald.commands.terminal import plain_where_needed

        plain_where_needed()
        print_report(report)
    return 0 if report["usable"] else 1


def _read(check: Check, logs: list[str]) -> None:
    from imucald.can.logs.log_reader import LogReader
    from imucald.commands.terminal import progress_bar

    with progress_bar("check") as progress:
        reader = LogReader(logs, None, False, progress)
        for chunk in reader:
            check.feed(chunk)
    check.bad_lines.update(reader.rejected)
    for text in reader.problems:
        print(f"imucald: {text}", file=sys.stderr)


def _listen(check: Check, loaded: LoadedConfig, options: argparse.Namespace) -> None:
    from imucald.check import EVERY_FRAME
    from imucald.commands.listening import listen
    from imucald.service.live import open_link

    link = open_link(loaded, EVERY_FRAME, frozenset(), options.interface, options.channel)
    listen(link, options.seconds, check.feed)
