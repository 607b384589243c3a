"""`imucald monitor`: watch a running daemon on a terminal, or in a browser."""

from __future__ import annotations

import argparse
import contextlib
import time
from collections.abc import Callable
from pathlib import Path

from imucald.commands.options import positive
from imucald.commands.status import add_socket_argument, asked, find_socket
from imucald.core.libraries import how_to_install

PERIOD_S = 0.5
"""Period of drawing the picture [s]."""
WEB_PORT = 8130


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `monitor`."""
    add_socket_argument(parser)
    parser.add_argument("--seconds", type=positive, metavar="S", help="stop after this time")
    add_web_argument(parser)
    parser.epilog = (
        "Exit status: 0 ended by Ctrl-C, 3 no daemon runs, 8 the daemon does not answer."
    )


def add_web_argument(parser: argparse.ArgumentParser) -> None:
    """Add the option for a web page instead of the terminal, also for `demo --live`."""
    parser.add_argument(
        "--web",
        type=int,
        nargs="?",
        const=WEB_PORT,
        metavar="PORT",
        help=f"show the status as a page at http://127.0.0.1:{WEB_PORT}, for this machine only "
        f"(needs {how_to_install('live')})",
    )


def run(options: argparse.Namespace) -> int:
    """Show the status until Ctrl-C. If the daemon stops, wait for it."""
    asked(options, "status")  # no daemon at the start is an error
    path = find_socket(options.socket, options.channel)
    seconds = float("inf") if options.seconds is None else options.seconds
    end = time.monotonic() + seconds
    watch(path, lambda: time.monotonic() >= end, options.web)
    return 0


def watch(path: Path, is_over: Callable[[], bool], web: int | None, note: str = "") -> None:
    """Show the status of the daemon at a socket until Ctrl-C or until `is_over` is true.

    is_over: called before each picture; after True, one last picture is shown. web: port of
    127.0.0.1 for a web page instead of the terminal. note: text shown below the picture.
    """
    if web is not None:
        from imucald.commands.monitor_web import serve

        serve(path, web, is_over, note)
    else:
        _watch_on_terminal(path, is_over, note)


def _watch_on_terminal(path: Path, is_over: Callable[[], bool], note: str) -> None:
    from rich.live import Live
    from rich.text import Text

    from imucald.commands.monitor_view import LiveEvent, asked_events, live_events, monitor_picture
    from imucald.commands.status_view import no_answer
    from imucald.commands.terminal import plain_console, plain_where_needed
    from imucald.core.errors import LinkError
    from imucald.service.asking import ask, content, understood

    plain_where_needed()
    console = plain_console()
    events: list[LiveEvent] = []
    foot = Text(f"{note or path}   Ctrl-C ends", style="dim")
    view = Live(
        console=console, auto_refresh=False, screen=console.is_terminal, vertical_overflow="crop"
    )
    status, picture, is_last, last = None, None, False, None
    with contextlib.suppress(KeyboardInterrupt), view as live:
        while not is_last:
            is_last = is_over()
            trouble = ""
            try:
                found = content(path, "status", ask(path, "status"))
                with understood(path):
                    events = live_events(found, time.time(), asked_events(path))
                    picture = monitor_picture(found, events, console, foot)
                status, last = found, time.time()
            except LinkError as error:
                trouble = no_answer(error, last)
                if status is not None:
                    picture = monitor_picture(status, events, console, foot, trouble)
            if picture is not None:
                live.update(picture, refresh=True)
            time.sleep(PERIOD_S)
