"""`imucald wait`: wait until a running daemon sends corrected frames of a quality, for scripts and
test benches."""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Mapping
from typing import Any

from imucald.commands.options import add_quiet

POLL_S = 0.5
REPEAT_S = 30.0
"""If only the numbers in a line change, the line is printed again after at least this time [s]."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `wait`."""
    from imucald.commands.status import add_socket_argument
    from imucald.runtime.flow import QUALITIES

    add_socket_argument(parser)
    parser.add_argument(
        "--state",
        choices=QUALITIES[1:4],
        default="usable",
        help="quality of the corrected frames to wait for, or better (default: usable)",
    )
    parser.add_argument(
        "--timeout", type=float, metavar="S", help="stop waiting after S seconds (default: never)"
    )
    add_quiet(parser, "print no lines")
    parser.epilog = (
        "If no daemon runs yet, the command waits for one. Exit status: 0 the quality is reached; "
        "no other exit status means this. After the timeout, the exit status of 'imucald status': "
        "4 usable or restored (not the quality that --state names), 5 not yet, 6 suspect, 7 a "
        "fault, 3 no daemon runs, 8 the daemon does not answer."
    )


def run(options: argparse.Namespace) -> int:
    """Request the status twice per second. If the missing conditions change, print these conditions
    and their progress."""
    from imucald.commands.status import FINE
    from imucald.core.errors import ImucaldError
    from imucald.core.text import without_numbers

    if options.timeout is not None and not options.timeout >= 0.0:
        raise ImucaldError("--timeout must be 0 or more seconds")
    end = time.monotonic() + (math.inf if options.timeout is None else options.timeout)
    said, repeats = "", -math.inf
    while True:
        reached, line = _asked(options)
        now = time.monotonic()
        is_new = without_numbers(line) != without_numbers(said)
        if not options.quiet and (is_new or (line != said and now >= repeats)):
            print(line, flush=True)
            said, repeats = line, now + REPEAT_S
        if reached == FINE or now >= end:
            return reached
        time.sleep(min(POLL_S, max(end - time.monotonic(), 0.0)))


def _asked(options: argparse.Namespace) -> tuple[int, str]:
    """Return the present exit status, and a line about frames and missing conditions. Raises
    LinkError if several daemons run and none is named, or if another program answers."""
    from imucald.commands.status import FINE, NOT_YET, asked, exit_status
    from imucald.commands.status_view import short
    from imucald.service.asking import BusyError, NotRunningError, understood

    try:
        status = json.loads(asked(options, "status"))
    except NotRunningError as error:
        return error.exit_status, "no daemon runs"
    except BusyError as error:
        return error.exit_status, "the daemon does not answer"
    with understood(options.socket):
        line = short(status, with_angles=False)
        return FINE if _is_reached(status, options.state) else exit_status(status) or NOT_YET, line


def _is_reached(status: Mapping[str, Any], state: str) -> bool:
    from imucald.runtime.flow import QUALITIES, FlowKind, flow

    is_served = flow(status).kind is FlowKind.SERVED
    return is_served and int(status["quality"]) >= QUALITIES.index(state)
