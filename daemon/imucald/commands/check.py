"""`imucald check`: what a configuration would decode, from a log or a live bus."""

from __future__ import annotations

import argparse
import json
import sys
import time
from typing import TYPE_CHECKING

from imucald.commands.options import LOG_HELP, add_bus, add_config

if TYPE_CHECKING:
    from imucald.can.link.link import Frame
    from imucald.config import LoadedConfig
    from imucald.config_check import Check

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
    from imucald.api.checking import check, check_report
    from imucald.api.configuration import Configuration
    from imucald.commands.files import check_files
    from imucald.commands.terminal import progress_bar
    from imucald.config_check import Check
    from imucald.core.errors import ConfigError

    if options.logs and (options.interface or options.channel):
        raise ConfigError("either LOG or --interface and --channel: not both")
    if not options.seconds > 0:
        raise ConfigError("--seconds must be positive")
    check_files((options.config, *options.database, *options.logs), ())
    config = Configuration.load(options.config, options.database)
    for text in config.warnings:
        print(f"imucald: warning: {text}", file=sys.stderr)
    if options.logs:
        with progress_bar("check") as progress:
            found = check(config, options.logs, progress=progress)
        for text in found.problems:
            print(f"imucald: {text}", file=sys.stderr)
    else:
        checker = Check(config.loaded)
        _listen(checker, config.loaded, options)
        found = check_report(checker)
    report = found.to_dict()
    if options.json:
        json.dump(report, sys.stdout, indent=2, allow_nan=False, ensure_ascii=False)
        print()
    else:
        from imucald.commands.check_view import print_report
        from imucald.commands.terminal import plain_where_needed

        plain_where_needed()
        print_report(report)
    return 0 if report["usable"] else 1


def _listen(check: Check, loaded: LoadedConfig, options: argparse.Namespace) -> None:
    from imucald.commands.terminal import countdown
    from imucald.config_check import EVERY_FRAME
    from imucald.service.live import open_link

    link = open_link(loaded, EVERY_FRAME, frozenset(), options.interface, options.channel)
    with link, countdown(f"listening on {link.channel}", options.seconds) as tick:
        began = time.monotonic()
        waiting: list[Frame] = []
        while (passed := time.monotonic() - began) < options.seconds:
            waiting += link.receive(min(0.1, options.seconds - passed))
            if len(waiting) >= 10_000:
                _feed(check, waiting, link.channel)
                waiting = []
            tick(passed)
        _feed(check, waiting, link.channel)


def _feed(check: Check, frames: list[Frame], channel: str) -> None:
    if frames:
        from imucald.config_check import columns_of

        check.feed(columns_of(frames, channel))
