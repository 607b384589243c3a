"""`imucald events`: print the last events of a running daemon, with their times."""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import textwrap
import time


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `events`."""
    from imucald.commands.status import add_socket_argument

    add_socket_argument(parser)
    parser.add_argument(
        "-n", type=int, default=20, metavar="N", help="show the last N events (default: 20)"
    )
    parser.add_argument(
        "--json", action="store_true", help="print the events as JSON, with times in Unix seconds"
    )
    parser.epilog = (
        "The daemon keeps the last 200 events since its start: changes of state, alarms, "
        "orders and their users, reloads, errors of the bus. The system's journal contains all "
        "events, also from earlier runs: journalctl -u imucald@can0. Exit status: 0 done, 3 no "
        "daemon runs, 8 the daemon does not answer."
    )


def run(options: argparse.Namespace) -> int:
    """Print the events, oldest first."""
    from imucald.commands.status import asked
    from imucald.core.errors import ImucaldError
    from imucald.service.asking import understood

    if options.n < 1:
        raise ImucaldError("-n must be 1 or more")
    events = json.loads(asked(options, "events"))["events"][-options.n :]
    if options.json:
        json.dump(events, sys.stdout, indent=2, ensure_ascii=False)
        print()
        return 0
    columns = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
    with understood(options.socket):
        for event in events:
            at = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(event["at"]))
            line = f"{at}  {event['level']:7}  {event['text']}"
            indent = " " * (len(line) - len(event["text"]))
            whole = textwrap.fill(line, columns or 80, subsequent_indent=indent)
            print(line if columns is None else whole)
    return 0
