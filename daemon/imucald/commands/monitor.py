"""`imucald monitor`: watch a running daemon on a terminal."""

from __future__ import annotations

import argparse
import contextlib
import json
import time

from imucald.commands.status import add_socket_argument, find_socket

PERIOD_S = 0.5
"""The picture is made anew so often [s]."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `monitor`."""
    add_socket_argument(parser)
    parser.add_argument("--seconds", type=float, metavar="S", help="stop by itself after this time")


def run(options: argparse.Namespace) -> int:
    """Show the status until Ctrl-C; a daemon that goes away is waited for."""
    from rich.console import Group
    from rich.live import Live
    from rich.text import Text

    from imucald.commands.status_view import picture
    from imucald.commands.terminal import plain_console, plain_where_needed
    from imucald.core.errors import LinkError
    from imucald.service.status import ask

    plain_where_needed()
    path = find_socket(options.socket, options.channel)
    status = json.loads(ask(path, "status"))  # nobody there at the start is an error
    end = time.monotonic() + (options.seconds or float("inf"))
    console = plain_console()
    foot = Text(f"{path}   Ctrl-C ends", style="dim")
    view = Live(console=console, auto_refresh=False, screen=console.is_terminal)
    with contextlib.suppress(KeyboardInterrupt), view as live:
        while time.monotonic() < end:
            try:
                status = json.loads(ask(path, "status"))
                note = Text("")
            except (LinkError, ValueError) as error:
                note = Text(f"no answer: {error}", style="bold red")
            live.update(Group(picture(status), note, foot), refresh=True)
            time.sleep(PERIOD_S)
    return 0
