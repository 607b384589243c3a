"""`imucald feed`: send a running daemon's results to MQTT, a KUKSA databroker or Foxglove."""

from __future__ import annotations

import argparse
import importlib.util
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from imucald.commands.options import positive
from imucald.core.errors import ImucaldError
from imucald.core.libraries import how_to_install

if TYPE_CHECKING:
    from imucald.feeds.feed_loop import Receiver

LIBRARIES = {"mqtt": "paho", "kuksa": "kuksa_client", "foxglove": "foxglove"}
MQTT_PORT, MQTT_TLS_PORT, KUKSA_PORT, FOXGLOVE_PORT = 1883, 8883, 55555, 8765
TARGETS = {
    "mqtt": "to an MQTT broker, as JSON",
    "kuksa": "to a KUKSA databroker, as VSS signals",
    "foxglove": "to Foxglove, which connects to this program",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `feed` for each target."""
    targets = parser.add_subparsers(
        dest="target", metavar="TARGET", required=True, help="receiver of the results"
    )
    for name, text in TARGETS.items():
        sub = targets.add_parser(
            name, help=text, description=f"Send the results of a running daemon {text}."
        )
        _add_source(sub)
        {"mqtt": _add_mqtt, "kuksa": _add_kuksa, "foxglove": _add_foxglove}[name](sub)


def _add_mqtt(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--broker",
        default="localhost",
        metavar="HOST[:PORT]",
        help=f"default: localhost:{MQTT_PORT}, with --ca port {MQTT_TLS_PORT}",
    )
    parser.add_argument(
        "--topic", metavar="TOPIC", help="beginning of every topic (default: imucald/CHANNEL)"
    )
    parser.add_argument(
        "--user",
        metavar="NAME",
        help="user name at the broker; set its password in $IMUCALD_MQTT_PASSWORD",
    )
    _add_ca(parser)


def _add_kuksa(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--databroker",
        default="localhost",
        metavar="HOST[:PORT]",
        help=f"default: localhost:{KUKSA_PORT}",
    )
    parser.add_argument(
        "--token", type=Path, metavar="FILE", help=("file with the access token of the databroker")
    )
    parser.add_argument(
        "--server-name", metavar="NAME", help="host name in the server's certificate"
    )
    _add_ca(parser)


def _add_ca(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--ca", type=Path, metavar="FILE", help=("use TLS, and trust the certificates of this file")
    )


def _add_foxglove(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--listen",
        default="127.0.0.1",
        metavar="HOST[:PORT]",
        help=(
            f"address to listen on (default: 127.0.0.1:{FOXGLOVE_PORT}). With another address, "
            "everybody who can connect to it can read the data"
        ),
    )
    parser.set_defaults(ca=None)


def _add_source(parser: argparse.ArgumentParser) -> None:
    from imucald.commands.status import add_socket_argument

    add_socket_argument(parser)
    parser.add_argument(
        "--rate", type=positive, default=10.0, metavar="HZ",
        help=(
            "corrected values per second; each value is the mean of the samples since the "
            "previous value (default: 10)"
        ),
    )  # fmt: skip
    parser.add_argument(
        "--accept", choices=("fine", "usable", "restored"), default="usable",
        help="least quality of the corrected values that are sent (default: usable)",
    )  # fmt: skip
    parser.add_argument(
        "--status-only",
        action="store_true",
        help="send only the mount and its state; do not open the bus",
    )
    parser.add_argument(
        "--config",
        type=Path,
        metavar="FILE",
        help=(
            "configuration of the daemon; needed if the path that the daemon states does not "
            "exist on this machine"
        ),
    )
    parser.epilog = (
        "The feed runs until Ctrl-C or SIGTERM. If the daemon or the receiver is absent, the "
        "feed reports this and waits. If several daemons run and none is named, the feed ends "
        "with exit status 1. docs/feeds.md lists the values that it sends."
    )


def run(options: argparse.Namespace) -> int:
    """Run the feed until SIGINT or SIGTERM."""
    from imucald.feeds.corrected_frames import FINE, RESTORED, USABLE
    from imucald.feeds.daemon_source import DaemonSource
    from imucald.feeds.feed_loop import Feed
    from imucald.service.exposition import bus_of

    library = LIBRARIES[options.target]
    if importlib.util.find_spec(library) is None:
        extra = options.target
        raise ImucaldError(f"feed {extra} needs a library: {how_to_install(extra)}")
    if not 0.1 <= options.rate <= 100.0:
        raise ImucaldError("--rate must be 0.1 to 100")
    _receiver(options, options.channel or "bus")  # a wrong option is reported without a daemon
    stopped: list[bool] = []
    _on_end(lambda: stopped.append(True))
    socket = _socket(options, lambda: bool(stopped))
    if socket is None:
        return 0
    receiver = _receiver(options, options.channel or bus_of(socket))
    least = {"fine": FINE, "usable": USABLE, "restored": RESTORED}[options.accept]
    source = DaemonSource(
        socket,
        _say,
        range(least, FINE + 1),
        options.config,
        not options.status_only,
        wants_raw=options.target == "foxglove",
    )
    feed = Feed(source, receiver, 1.0 / options.rate, _say)
    _on_end(lambda: setattr(feed, "stopping", True))
    feed.stopping = bool(stopped)
    try:
        feed.run()
    finally:
        source.close()
    return 0


def _on_end(stop: Callable[[], None]) -> None:
    import signal

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop())


def _socket(options: argparse.Namespace, is_stopped: Callable[[], bool]) -> Path | None:
    """Return the status socket; None if the feed was stopped while it waited for any daemon."""
    from imucald.commands.status import find_socket, running_sockets
    from imucald.service.asking import running_socket

    has_waited = False
    while options.socket is None and not running_sockets(options.channel):
        if options.channel:
            return running_socket(options.channel)
        if not has_waited:
            _say("no running daemon found; waiting for one")
            has_waited = True
        time.sleep(1.0)
        if is_stopped():
            return None
    return find_socket(options.socket, options.channel)


def _receiver(options: argparse.Namespace, bus: str) -> Receiver:
    if options.ca is not None and not options.ca.is_file():
        raise ImucaldError(f"--ca {options.ca}: there is no such file")
    if options.target == "mqtt":
        from imucald.feeds.mqtt import MqttReceiver, MqttSettings

        host, port = _address(options.broker, MQTT_TLS_PORT if options.ca else MQTT_PORT)
        topic = (options.topic or f"imucald/{bus}").rstrip("/")
        if not topic or "#" in topic or "+" in topic:
            raise ImucaldError(
                f"--topic {topic!r}: the topic must not be empty and must not contain '#' or '+'"
            )
        return MqttReceiver(MqttSettings(host, port, topic, options.user, options.ca), _say)
    if options.target == "foxglove":
        from imucald.feeds.foxglove import FoxgloveReceiver, FoxgloveSettings

        return FoxgloveReceiver(FoxgloveSettings(*_address(options.listen, FOXGLOVE_PORT)), _say)
    from imucald.feeds.kuksa import KuksaReceiver, KuksaSettings

    if options.token is not None and not options.token.is_file():
        raise ImucaldError(f"--token {options.token}: there is no such file")
    host, port = _address(options.databroker, KUKSA_PORT)
    return KuksaReceiver(
        KuksaSettings(host, port, options.token, options.ca, options.server_name), _say
    )


def _address(text: str, port: int) -> tuple[str, int]:
    host, colon, given = text.rpartition(":")
    if not colon or (host.count(":") and not host.endswith("]")):
        return text.strip("[]"), port
    if not given.isdecimal() or not 0 < int(given) <= 0xFFFF or not host:
        raise ImucaldError(f"{text!r} is not an address: write HOST or HOST:PORT")
    return host.strip("[]"), int(given)


def _say(text: str) -> None:
    print(f"imucald: {text}", file=sys.stderr, flush=True)
