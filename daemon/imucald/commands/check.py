"""`imucald check`: show the signals that a configuration decodes from a log or a live bus."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from imucald.commands.options import (
    LOG_HELP,
    add_bus,
    add_config,
    add_quiet,
    configuration,
    positive,
    print_problems,
    refuse_log_and_bus,
)

if TYPE_CHECKING:
    from imucald.can.columns import FrameColumns
    from imucald.can.link.link import Frame, Link
    from imucald.config import LoadedConfig
    from imucald.config_check import Check

LISTEN_S = 10.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `check`."""
    parser.epilog = (
        "Without LOG, check listens on the configuration's bus; check never sends. Exit status: 0 "
        "the configuration can be used, 1 something necessary is missing or wrong. With "
        "--strict, warnings give 1 too."
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
        type=positive,
        default=LISTEN_S,
        metavar="S",
        help=f"how long to listen without LOG (default: {LISTEN_S:g})",
    )
    parser.add_argument("--strict", action="store_true", help="warnings give exit status 1 too")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    add_quiet(parser, "print no progress and no report; the exit status gives the result")


def run(options: argparse.Namespace) -> int:
    """Read the frames, then print the report."""
    from imucald.api.checking import check, check_report
    from imucald.commands.files import check_files
    from imucald.commands.terminal import progress_bar
    from imucald.runtime.summary import as_json
    from imucald.service.uds_on_bus import check_start

    refuse_log_and_bus(options)
    check_files((options.config, *options.database, *options.logs), ())
    config = configuration(options)
    check_start(config.loaded)
    if options.logs:
        with progress_bar("check", options.quiet) as progress:
            found = check(config, options.logs, progress=progress)
        print_problems(found.problems)
    else:
        checker = _for_a_bus(config.loaded, options)
        _listen(checker, config.loaded, options)
        found = check_report(checker)
    report = found.to_dict()
    passed = report["usable"] and not (options.strict and report["warnings"])
    if options.json:
        sys.stdout.write(as_json(report))
    elif not options.quiet:
        from imucald.commands.check_view import print_report
        from imucald.commands.terminal import plain_where_needed

        plain_where_needed()
        print_report(report, options.strict)
    return 0 if passed else 1


def _for_a_bus(loaded: LoadedConfig, options: argparse.Namespace) -> Check:
    from imucald.config_check import Check

    interface = options.interface or loaded.config.bus.interface
    channel = options.channel or loaded.config.bus.channel
    remedy = "the plug, the ignition and the bit rate ('bus: bitrate:')"
    if interface == "socketcan":
        remedy = (
            f"the plug, the ignition and the bit rate: ip -details -statistics link show {channel}"
        )
    text = f"no frame came in {options.seconds:g} s on {channel}. Check {remedy}"
    return Check(loaded, text)


def _listen(check: Check, loaded: LoadedConfig, options: argparse.Namespace) -> None:
    from imucald.config_check import EVERY_FRAME
    from imucald.service.live import open_link

    link = open_link(loaded, EVERY_FRAME, frozenset(), options.interface, options.channel)
    listen(link, options.seconds, check.feed)


def listen(link: Link, seconds: float, feed: Callable[[FrameColumns], None]) -> None:
    """Pass on the frames that an open link receives in `seconds` [s], then close the link."""
    from imucald.can.logs.frame_batches import columns_of_frames
    from imucald.commands.terminal import countdown

    with link, countdown(f"listening on {link.channel}", seconds) as tick:
        began = time.monotonic()
        waiting: list[Frame] = []

        def pass_on() -> None:
            frames = [(t, can_id, data, 0, False) for t, can_id, data in waiting]
            feed(columns_of_frames(frames, (link.channel,)))
            waiting.clear()

        while (passed := time.monotonic() - began) < seconds:
            waiting += link.receive(min(0.1, seconds - passed))
            if len(waiting) >= 10_000:
                pass_on()
            tick(passed)
        if waiting:
            pass_on()
