"""`imucald metrics`: metrics of running daemons for Prometheus, as text, as file or over HTTP."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `metrics`."""
    from imucald.commands.status import add_socket_argument

    add_socket_argument(parser)
    way = parser.add_mutually_exclusive_group()
    way.add_argument(
        "--textfile",
        type=Path,
        metavar="FILE",
        help="write the metrics into FILE, for node_exporter's textfile collector. FILE is "
        "replaced atomically. A device, pipe or link is refused",
    )
    way.add_argument(
        "--listen",
        metavar="HOST:PORT",
        help=(
            "serve the metrics at http://HOST:PORT/metrics until Ctrl-C, for example at "
            "127.0.0.1:8131"
        ),
    )
    parser.epilog = (
        "Without a channel, the metrics of all daemons on this machine are written, with the "
        "label 'bus'. A daemon that does not answer has imucald_up 0. The exit status is 0 even "
        "if no daemon runs."
    )


def run(options: argparse.Namespace) -> int:
    """Print, write or serve the metrics."""
    if options.listen:
        return _listen(options)
    text = _text_of(options)()
    if options.textfile:
        _write(options.textfile, text)
    else:
        sys.stdout.write(text)
    return 0


def _text_of(options: argparse.Namespace) -> Callable[[], str]:
    from imucald.commands.status import running_sockets
    from imucald.service.exposition import gathered

    def text() -> str:
        chosen = [options.socket] if options.socket else running_sockets(options.channel)
        return gathered(chosen)

    return text


def _listen(options: argparse.Namespace) -> int:
    from imucald.service.listening import listening_at

    listening = listening_at(options.listen)
    host, port = listening.getsockname()[:2]
    shown = f"[{host}]" if ":" in host else host
    print(f"imucald: metrics at http://{shown}:{port}/metrics", file=sys.stderr)
    serve(listening, _text_of(options))
    return 0


def serve(listening: socket.socket, text: Callable[[], str]) -> None:
    """Serve the metrics without end."""
    from imucald.service.metrics_server import MetricsServer

    with MetricsServer(listening, text) as server:
        server.serve_forever()


def _write(path: Path, text: str) -> None:
    """Replace or create a regular file. Any other path is an error."""
    from imucald.core.errors import ImucaldError
    from imucald.core.files import write_file

    try:
        if not _may_replace(path):
            raise ImucaldError(
                f"{path}: this is not a regular file (it may be a device, a pipe or a link), "
                "so nothing is written; name a file, or leave --textfile out to print the "
                "metrics"
            )
        write_file(path, text.encode(), 0o644)  # node_exporter runs as another user
    except OSError as error:
        raise ImucaldError(f"{path}: cannot be written: {error.strerror or error}") from None


def _may_replace(path: Path) -> bool:
    import stat

    try:
        return stat.S_ISREG(path.lstat().st_mode)
    except FileNotFoundError:
        return True
