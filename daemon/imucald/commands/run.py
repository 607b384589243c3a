"""`imucald run`: the live daemon."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from imucald.commands.options import add_bus, add_config, positive

if TYPE_CHECKING:
    from imucald.core.errors import ConfigError
    from imucald.service.journal import Journal
    from imucald.service.listening import ServingProcess
    from imucald.service.parts import ServiceOptions

LOG_LEVELS = ("error", "warning", "notice", "info")
"""Names of the log levels in `service.journal`. The names are repeated here, because
`service.journal` is loaded later."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `run`."""
    parser.epilog = (
        "Ctrl-C or SIGTERM stops the daemon. After SIGHUP the daemon reads the configuration "
        "again. Exit status: 0 stopped, 1 an error (for example: the interface does not exist), 78 "
        "the configuration is wrong.\n\n  imucald run --config car.yaml\n  imucald run --config "
        "car.yaml --channel can0 --state-dir state"
    )
    add_config(parser)
    add_bus(parser)
    parser.add_argument(
        "--check",
        action="store_true",
        help="check whether the daemon can start, without opening a bus. Exit status: 0 it can, "
        "78 it cannot (the text says why)",
    )
    parser.add_argument("--seconds", type=positive, metavar="S", help="stop after this time")
    parser.add_argument(
        "--state-dir",
        type=Path,
        metavar="DIR",
        help="folder in which the calibration is saved (default: systemd's $STATE_DIRECTORY; "
        "without both, nothing is saved)",
    )
    parser.add_argument(
        "--save-every",
        type=positive,
        default=10.0,
        metavar="S",
        help="save the calibration every S seconds (default: 10)",
    )
    parser.add_argument(
        "--status-socket",
        type=Path,
        metavar="PATH",
        help="socket that answers 'imucald status' (default: in $RUNTIME_DIRECTORY, in "
        "$XDG_RUNTIME_DIR or, as root, in /run/imucald)",
    )
    parser.add_argument(
        "--metrics-listen",
        metavar="HOST:PORT",
        help=(
            "serve metrics at http://HOST:PORT/metrics from a separate process, for example at "
            "127.0.0.1:8131"
        ),
    )
    parser.add_argument("--json", metavar="FILE", help="write the result as JSON at the end")
    parser.add_argument(
        "--log-level",
        choices=LOG_LEVELS,
        default="info",
        help="log lines of this level and above (default: info, which is all lines). 'imucald "
        "events' always shows all lines",
    )
    parser.add_argument("-q", "--quiet", action="store_true", help="log only warnings and errors")


def run(options: argparse.Namespace) -> int:
    """Run the daemon until SIGINT or SIGTERM. SIGHUP reads the configuration again; SIGUSR1 repeats
    the sensor check."""
    import signal

    early: set[int] = set()  # received during the start; by default they would end it
    for number in (signal.SIGHUP, signal.SIGUSR1):
        signal.signal(number, lambda asked, _: early.add(asked))

    import os

    from imucald.commands.files import check_files, fill_standard_files, write_text
    from imucald.core.errors import ConfigError, ImucaldError
    from imucald.core.file_cache import keep_databases
    from imucald.runtime.summary import as_json
    from imucald.service.asking import default_socket
    from imucald.service.journal import PRIORITIES, WARNING, Journal
    from imucald.service.notify import end_count, start_count_file
    from imucald.service.parts import ServiceOptions
    from imucald.service.service import Service

    fill_standard_files()
    described = [path for path in (options.config, *options.database) if path.exists()]
    check_files(described, (options.json,))  # a missing input has its own exit status below
    if options.state_dir is not None and options.state_dir.is_file():
        raise ImucaldError(f"--state-dir {options.state_dir}: this is a file; name a folder")
    journal = Journal(level=WARNING if options.quiet else PRIORITIES[options.log_level])
    keep_databases(os.environ)
    if options.check:
        return _checked(options, journal)
    folder = options.state_dir or os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    settings = ServiceOptions(
        config=options.config,
        databases=options.database,
        interface=options.interface,
        channel=options.channel,
        state_folder=Path(folder) if folder else None,
        status_socket=options.status_socket or default_socket(options.channel or "bus"),
        socket_needed=options.status_socket is not None,
        save_period=options.save_every,
        start_count=start_count_file(os.environ),
    )
    _say_what_lacks(settings, journal)
    metrics = _metrics_process(options.metrics_listen, settings.status_socket)
    try:
        service = Service(settings, journal, companion=metrics)
    except ConfigError as error:
        end_count(settings.start_count)
        return _wrong(error, journal)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: service.stop())
    asked = {signal.SIGHUP: service.ask_reload, signal.SIGUSR1: service.ask_sensor_check}
    for number, ask in asked.items():
        signal.signal(number, lambda *_, ask=ask: ask())
        if number in early:
            ask()
    try:
        service.run(float("inf") if options.seconds is None else options.seconds)
    finally:
        service.close()
    end_count(settings.start_count)
    result = service.result()
    if options.json:
        write_text(options.json, as_json(result))
    journal.say(f"stopped; state {result['state']}, {service.engine.sent} frames sent")
    return 0


def _say_what_lacks(settings: ServiceOptions, journal: Journal) -> None:
    from imucald.core import compiled
    from imucald.service.journal import NOTICE, WARNING

    if slow := compiled.slow_words():
        journal.say(slow)
    if settings.state_folder is None:
        text = (
            "the mount is not saved, since no folder is named: the next start begins without it. "
            "Give --state-dir DIR to save it"
        )
        journal.say(text, NOTICE)
    if settings.status_socket is None:
        text = (
            "there is no status socket, since XDG_RUNTIME_DIR is not set: 'imucald status', "
            "'monitor' and orders cannot reach this daemon. Set XDG_RUNTIME_DIR to a folder for "
            "all these commands, or give --status-socket PATH to 'run' and --socket PATH to the "
            "others"
        )
        journal.say(text, WARNING)


def _wrong(error: ConfigError, journal: Journal) -> int:
    from imucald.service.journal import ERROR

    for line in str(error).splitlines():
        journal.say(line, ERROR)
    return 78  # EX_CONFIG: systemd does not start the daemon again


def _checked(options: argparse.Namespace, journal: Journal) -> int:
    """Read all files that the service reads at start or reload, without a bus."""
    from imucald.core.errors import ConfigError
    from imucald.runtime.session import open_config
    from imucald.service.announcements import say_idle_keys
    from imucald.service.uds_on_bus import check_start

    try:
        loaded = open_config(options.config, options.database)
        check_start(loaded)
    except ConfigError as error:
        return _wrong(error, journal)
    say_idle_keys(loaded, journal)
    journal.say(f"{options.config} can be used")
    return 0


def _metrics_process(address: str | None, status_socket: Path | None) -> ServingProcess | None:
    if address is None:
        return None
    from imucald.commands.metrics import serve
    from imucald.core.errors import LinkError
    from imucald.service.exposition import gathered
    from imucald.service.listening import ServingProcess, listening_at

    if status_socket is None:
        raise LinkError("--metrics-listen needs a status socket: give --status-socket PATH too")
    listening = listening_at(address)
    return ServingProcess(listening, lambda bound: serve(bound, lambda: gathered([status_socket])))
