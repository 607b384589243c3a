"""Send an order to a running daemon, for `reset`, `hold`, `release` and `set-mount`."""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from imucald.core.errors import ImucaldError, LinkError

WHO = (
    " Orders are accepted from root and from the user of the daemon. Log and events "
    "show each order and the user who gave the order. Exit status: 0 done, 1 refused "
    "(the text says why), 3 no daemon runs, 8 the daemon does not answer."
)
NOT_RUNNING = 3
"""Exit status if no daemon runs. `systemctl is-active` and the command `status` of init scripts use
the same number."""


def add_target(parser: argparse.ArgumentParser, about: str, example: str = "") -> None:
    """Add the options that select daemons. about: what the order does, for the help text."""
    from imucald.commands.status import add_socket_argument

    add_socket_argument(
        parser,
        "status socket of the daemon; the control socket in the same folder receives the order",
    )
    parser.add_argument("--all", action="store_true", help="every daemon that runs here")
    parser.epilog = about + WHO + example


def give(options: argparse.Namespace, order: str, **more: Any) -> int:
    """Send an order to the selected daemons, print their answers, and return the exit status."""
    from imucald.commands.status import find_socket, running_sockets

    if options.all and (options.channel or options.socket):
        raise ImucaldError("--all means every daemon; leave the channel and --socket out")
    if options.all:
        sockets = running_sockets()
    else:
        try:
            sockets = [find_socket(options.socket, options.channel)]
        except LinkError as error:
            if running_sockets(options.channel):
                raise
            print(f"imucald: {error}", file=sys.stderr)
            return NOT_RUNNING
    if not sockets:
        print("imucald: no daemon runs here", file=sys.stderr)
        return NOT_RUNNING
    user = os.environ.get("SUDO_USER", "")
    if re.fullmatch(r"[A-Za-z0-9_.-]{1,32}", user):
        more["sudo_user"] = user
    return max(_given(path, {"order": order, **more}, len(sockets) > 1) for path in sockets)


def _given(status_socket: Path, request: Mapping[str, Any], is_named: bool) -> int:
    from imucald.commands.status import BUSY
    from imucald.service.asking import BusyError, ask, control_socket

    path = control_socket(status_socket)
    if path.exists() and not os.access(path, os.R_OK | os.W_OK):
        command = "sudo imucald ..."
        raise ImucaldError(
            f"{path}: you may not give orders to this daemon; run it as root: {command}"
        )
    try:
        answer = json.loads(ask(path, json.dumps(request), is_repeatable=False))
    except BusyError as error:
        print(f"imucald: {error}", file=sys.stderr)
        return BUSY
    except LinkError as error:
        print(f"imucald: {error}", file=sys.stderr)
        return NOT_RUNNING
    except ValueError:
        raise ImucaldError(
            f"{path}: the answer is not from an imucald daemon; name the status socket of "
            "the daemon (--socket PATH)"
        ) from None
    name = f"{status_socket.parent.name}: " if is_named else ""
    if "done" in answer:
        print(f"{name}{answer['done']}")
        return 0
    text = answer.get("error", "the daemon gave no answer; see its log")
    print(f"imucald: {name}{text}", file=sys.stderr)
    return 1
