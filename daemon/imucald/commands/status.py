"""`imucald status`: print the status of a running daemon."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from imucald.core.errors import LinkError

FINE, USABLE, NOT_YET, SUSPECT, FAULT = 0, 4, 5, 6, 7
"""Exit statuses that say how the mount is. For 3 and 8 see `NotRunningError` and `BusyError`."""
ASK_S = 1.0
"""Longest time for a daemon to state its channel [s]."""
_BY_STATE = {
    "fine": FINE,
    "usable": USABLE,
    "restored": USABLE,
    "waiting": NOT_YET,
    "levelled": NOT_YET,
    "suspect": SUSPECT,
    "recalibrating": SUSPECT,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `status`."""
    add_socket_argument(parser)
    form = parser.add_mutually_exclusive_group()
    form.add_argument(
        "--short", "-s", action="store_true", help="print one line, for scripts and prompts"
    )
    form.add_argument("--json", action="store_true", help="print everything as JSON")
    form.add_argument("--metrics", action="store_true", help="print the metrics as Prometheus text")
    form.add_argument(
        "--quiet", "-q", action="store_true", help="print nothing; the exit status gives the state"
    )
    parser.epilog = (
        "Exit status, for scripts: 0 fine, 4 usable or restored, 5 not yet (starting, "
        "waiting, levelled), 6 suspect or recalibrating, 7 a fault (bus not up, an input "
        "missing or faulty, frames not sent, another sender of our identifiers), 3 no daemon "
        "runs, 8 the daemon does not answer, 1 any other error. With --metrics: 0, 3 or 8. "
        "A fault gives 7 in every state of the mount."
    )


def add_socket_argument(
    parser: argparse.ArgumentParser, socket_help: str = "status socket of the daemon"
) -> None:
    """Add the options that select a daemon. `monitor` uses them too."""
    parser.add_argument(
        "channel",
        nargs="?",
        help="interface of the daemon, such as can0; needed if several daemons run",
    )
    parser.add_argument("--socket", type=Path, metavar="PATH", help=socket_help)


def run(options: argparse.Namespace) -> int:
    """Print the status, and return it as an exit status."""
    answer = asked(options, "metrics" if options.metrics else "status")
    if options.metrics:
        sys.stdout.write(answer)
        return 0
    from imucald.service.asking import understood

    status = json.loads(answer)
    with understood(options.socket):
        found = exit_status(status)
        if options.json:
            print(json.dumps(status, indent=2, ensure_ascii=False))
        elif options.short:
            from imucald.commands.status_view import short

            print(short(status))
        elif not options.quiet:
            from imucald.commands.status_view import print_status
            from imucald.commands.terminal import plain_console, plain_where_needed

            plain_where_needed()
            print_status(plain_console(), status)
    return found


def exit_status(status: Mapping[str, Any]) -> int:
    """Return the exit status for a daemon's status."""
    from imucald.runtime.flow import PASSING, is_starting, present_alarms

    if status["link"]["state"] != "up" or set(present_alarms(status)) - PASSING:
        return FAULT
    if is_starting(status):
        return NOT_YET
    return _BY_STATE.get(status["state"], FAULT)


def asked(options: argparse.Namespace, request: str) -> str:
    """Return the answer of the selected daemon. Raises LinkError if there is none."""
    from imucald.service.asking import KINDS, ask, content

    path = find_socket(options.socket, options.channel)
    answer = ask(path, request)
    if request in KINDS:
        content(path, request, answer)
    return answer


def running_sockets(channel: str | None = None) -> list[Path]:
    """Return the status sockets of all daemons on this machine. With `channel`, return only the
    sockets of daemons on this channel."""
    from imucald.core.text import encodable
    from imucald.service.asking import RUNNING

    found = [*RUNNING.glob("*/status.sock")]
    if runtime := os.environ.get("XDG_RUNTIME_DIR"):
        found += Path(runtime).glob("imucald-*.sock")
    if channel is not None:
        names = {channel, f"imucald-{channel}"}
        named = [p for p in found if p.parent.name in names or p.stem in names]
        found = named or [p for p in found if _channel_of(p) == encodable(channel)]
    return sorted(found)


def _channel_of(path: Path) -> str | None:
    """Ask a daemon for its channel, which only its configuration may name."""
    from imucald.service.asking import ask, content

    try:
        return str(content(path, "status", ask(path, "status", ASK_S))["link"]["channel"])
    except (LinkError, LookupError):
        return None


def find_socket(given: Path | None, channel: str | None) -> Path:
    """Return the selected socket. Raises NotRunningError if there is none, and LinkError, which
    lists them, if there are several."""
    from imucald.service.asking import NotRunningError

    if given is not None:
        return given
    found = running_sockets(channel)
    if len(found) == 1:
        return found[0]
    if not found:
        which = f" for {channel}" if channel else ""
        raise NotRunningError(
            f"no running daemon found{which}; start one (imucald run --config FILE, or systemctl "
            "start imucald@can0), or name the status socket of a daemon (--socket PATH)"
        )
    choice = ", ".join(str(path) for path in found)
    raise LinkError(f"several daemons run; name one by its channel or by --socket: {choice}")
