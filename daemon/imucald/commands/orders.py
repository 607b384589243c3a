"""Send an order to a running daemon: `imucald reset`, `hold`, `release` and `set-mount`."""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from imucald.commands.options import numbers
from imucald.core.errors import ImucaldError, LinkError

ABOUT = {
    "reset": "The learnt and the saved mount are discarded. This cannot be undone. A mount that "
    "the configuration states ('calibration: mount') is used again after the reset.",
    "hold": "A hold continues after a restart. Data recorded during a hold is ignored. If the "
    "drive contradicts a held mount, the state becomes suspect.",
    "release": "A hold that the configuration states ('calibration: mount: hold: true') cannot be "
    "released by this command: remove it from the configuration, then reload.",
    "set-mount": "The angles are the mount angles that 'imucald status' shows. The state is "
    "'restored' until the drive confirms the mount. 'imucald status' shows a ± that is a little "
    "larger than --within, because it adds the effect of load and springs.",
}
"""What each order does, for the help text."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the order that the parser is for."""
    from imucald.commands.status import add_socket_argument

    order = parser.prog.rpartition(" ")[2]
    add_socket_argument(
        parser,
        "status socket of the daemon; the control socket in the same folder receives the order",
    )
    parser.add_argument("--all", action="store_true", help="every daemon that runs here")
    parser.epilog = ABOUT[order] + (
        " Orders are accepted from root and from the user of the daemon. Log and events "
        "show each order and the user who gave the order. Exit status: 0 done, 1 refused "
        "(the text says why), 3 no daemon runs, 8 the daemon does not answer."
    )
    if order == "set-mount":
        parser.epilog += "\n\n  imucald set-mount 14.1 28.5 -10.5 --within 1 --hold"
        _add_mount(parser)


def _add_mount(parser: argparse.ArgumentParser) -> None:
    for name in ("roll", "pitch", "yaw"):
        parser.add_argument(name, type=float, metavar=name.upper(), help=f"{name} [deg]")
    deviation = parser.add_mutually_exclusive_group(required=True)
    deviation.add_argument(
        "--within",
        metavar="DEG",
        help=(
            "uncertainty of the mount (95 %%), as the ± of 'imucald status': one number, or "
            "three with commas about the vehicle's forward, left and up axis"
        ),
    )
    deviation.add_argument(
        "--std",
        metavar="DEG",
        help="uncertainty of the mount as one standard deviation, half of --within",
    )
    parser.add_argument(
        "--hold", action="store_true", help="hold this mount: the daemon does not change it"
    )


def run(options: argparse.Namespace) -> int:
    """Send the order to the daemon."""
    more = {"mount": _mount(options)} if options.command == "set-mount" else {}
    return _give(options, options.command, **more)


def _mount(options: argparse.Namespace) -> dict[str, Any]:
    from imucald.config.calibration import KnownMount
    from imucald.core.typed import Document, typed
    from imucald.mount.estimate import ANGLES
    from imucald.mount.mount_words import SD_95

    name, text = ("--std", options.std) if options.within is None else ("--within", options.within)
    given = numbers(text)
    if len(given) not in (1, 3) or not all(0.0 < x < math.inf for x in given):
        form = "one number above 0, or three about x,y,z such as 0.3,0.3,0.5"
        raise ImucaldError(f"{name} takes {form} (here: {text})")
    if options.within is not None:
        given = [x / SD_95 for x in given]
    mount = {f"{name}_deg": getattr(options, name) for name in ANGLES}
    mount |= {"std_deg": given[0] if len(given) == 1 else given, "hold": options.hold}
    # the daemon's own texts are shorter
    typed(mount, KnownMount, Document("set-mount", {}, "the mount"))
    return mount


def _give(options: argparse.Namespace, order: str, **more: Any) -> int:
    from imucald.commands.status import find_socket, running_sockets
    from imucald.service.asking import NotRunningError

    if options.all and (options.channel or options.socket):
        raise ImucaldError("--all means every daemon; leave the channel and --socket out")
    one = options.socket, options.channel
    sockets = running_sockets() if options.all else [find_socket(*one)]
    if not sockets:
        raise NotRunningError("no daemon runs here")
    user = os.environ.get("SUDO_USER", "")
    if re.fullmatch(r"[A-Za-z0-9_.-]{1,32}", user):
        more["sudo_user"] = user
    return max(_given(path, {"order": order, **more}, len(sockets) > 1) for path in sockets)


def _given(status_socket: Path, request: Mapping[str, Any], is_named: bool) -> int:
    from imucald.service.asking import ask, control_socket

    path = control_socket(status_socket)
    if path.exists() and not os.access(path, os.R_OK | os.W_OK):
        command = "sudo imucald ..."
        raise ImucaldError(
            f"{path}: you may not give orders to this daemon; run it as root: {command}"
        )
    try:
        answer = json.loads(ask(path, json.dumps(request), is_repeatable=False))
    except LinkError as error:  # the others get the order nevertheless
        print(f"imucald: {error}", file=sys.stderr)
        return error.exit_status
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
