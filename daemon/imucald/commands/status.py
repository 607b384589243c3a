"""`imucald status`: ask a running daemon how it is."""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path

from imucald.core.errors import LinkError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `status`."""
    add_socket_argument(parser)
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="everything, as JSON")
    form.add_argument("--metrics", action="store_true", help="as Prometheus text")


def add_socket_argument(parser: argparse.ArgumentParser) -> None:
    """Which daemon is meant; `monitor` asks the same."""
    parser.add_argument(
        "channel", nargs="?", help="interface of the daemon, such as can0, where several run"
    )
    parser.add_argument("--socket", type=Path, metavar="PATH", help="its status socket")


def run(options: argparse.Namespace) -> int:
    """Print the status. Exit status 1 where no daemon answers."""
    from imucald.service.status import ask

    path = find_socket(options.socket, options.channel)
    if options.metrics:
        sys.stdout.write(ask(path, "metrics"))
        return 0
    status = json.loads(ask(path, "status"))
    if options.json:
        print(json.dumps(status, indent=2, ensure_ascii=False))
        return 0

    from imucald.commands.status_view import picture
    from imucald.commands.terminal import plain_console, plain_where_needed

    plain_where_needed()
    plain_console().print(picture(status))
    return 0


def find_socket(given: Path | None, channel: str | None) -> Path:
    """The socket that is meant; LinkError with the choice where that is not clear."""
    if given is not None:
        return given
    found = [*Path("/run/imucald").glob("*/status.sock")]
    if runtime := os.environ.get("XDG_RUNTIME_DIR"):
        found += Path(runtime).glob("imucald-*.sock")
    if channel is not None:
        names = {channel, f"imucald-{channel}"}
        found = [p for p in found if p.parent.name in names or p.stem in names]
    if len(found) == 1:
        return found[0]
    if not found:
        which = f" for {channel}" if channel else ""
        raise LinkError(f"no running daemon found{which}; --socket PATH names its status socket")
    choice = ", ".join(str(path) for path in sorted(found))
    raise LinkError(f"several daemons run, name one by channel or --socket: {choice}")
