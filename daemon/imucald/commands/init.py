"""`imucald init`: propose a configuration from a database and the frames on the bus."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from imucald.commands.options import LOG_HELP, positive, print_problems, refuse_log_and_bus
from imucald.core.text import counted

if TYPE_CHECKING:
    from imucald.can.dbc.database import Database
    from imucald.discovery import GatheredFrames, Proposal

LISTEN_S = 120.0
"""Default listening time [s]: a short drive with a stop, a start and some bends."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `init`."""
    parser.epilog = (
        "The recording should be a drive with stops and bends: two minutes at least, better ten. "
        "Without a recording the proposal uses names and units only. Check the result with: "
        "imucald check --config FILE LOG."
    )
    parser.add_argument("logs", nargs="*", metavar="LOG", help=LOG_HELP)
    parser.add_argument(
        "--database",
        action="append",
        default=[],
        type=Path,
        metavar="FILE",
        help="database of the bus (repeat for several)",
    )
    parser.add_argument(
        "--out",
        default="-",
        metavar="FILE",
        help="write the configuration here (default: standard output)",
    )
    parser.add_argument("--force", action="store_true", help="overwrite FILE if it exists")
    parser.add_argument(
        "--driving-side",
        choices=("left", "right", "unknown"),
        default="unknown",
        help="side of the road that you drive on. Roads slope to this side, and a recording does "
        "not show which side it is",
    )
    parser.add_argument(
        "--interface", help="listen on a bus: a python-can interface, or a name such as can0"
    )
    parser.add_argument("--channel", help="channel of this interface, such as can0")
    parser.add_argument(
        "--seconds",
        type=positive,
        default=LISTEN_S,
        metavar="S",
        help=f"how long to listen on the bus (default: {LISTEN_S:g}, enough for a stop, a start "
        "and some bends; with 600, units and signs are more certain). The option does not limit "
        "a LOG",
    )


def run(options: argparse.Namespace) -> int:
    """Read a log or listen on a bus, then write the proposal."""
    from imucald.can.dbc.database import load_database
    from imucald.commands.files import STANDARD, check_files, write_yaml
    from imucald.commands.schema import CONFIGURATION
    from imucald.core.errors import ConfigError
    from imucald.discovery import GatheredFrames, as_yaml, discover

    refuse_log_and_bus(options)
    if not options.database and not (options.logs or options.interface or options.channel):
        raise ConfigError("give --database FILE, a LOG, or --interface can0")
    out = None if options.out == STANDARD else options.out
    check_files((*options.database, *options.logs), (out,))
    if out and Path(out).is_file() and not options.force:
        text = "exists and may have been edited by hand; choose another name, or give --force"
        raise ConfigError(f"{out}: {text}")
    base = Path(options.out).resolve().parent if out else Path.cwd()
    databases: dict[str, Database] = {
        os.path.relpath(path.resolve(), base): load_database(path) for path in options.database
    }
    for database in databases.values():
        for line in database.left_out:
            print(f"imucald: {line}", file=sys.stderr)
    if options.logs:
        recording = _read(options.logs, databases)
    elif options.interface or options.channel:
        recording = _listen(options, databases)
    else:
        recording = GatheredFrames()
    proposal = discover(databases, recording)
    _require_matches(options, recording, proposal)
    proposal.driving_side = options.driving_side
    write_yaml(options.out, as_yaml(proposal, list(databases)), CONFIGURATION)
    print_problems(text for text in (proposal.loss, proposal.move) if text)
    if out:
        print(f"{options.out}: {_outcome(proposal, options)}", file=sys.stderr)
    return 0


def _require_matches(
    options: argparse.Namespace, recording: GatheredFrames, proposal: Proposal
) -> None:
    """Raise an error if the frames allow no proposal. In this case nothing is written."""
    from imucald.core.errors import ConfigError, LinkError, NoFramesError

    if not recording.frames:
        if options.logs:
            text = (
                "the log holds no CAN frame; give a log of this bus, or leave LOG out (then "
                "only the names in the database are used)"
            )
            raise NoFramesError(f"{', '.join(options.logs)}: {text}")
        if options.interface or options.channel:
            text = (
                f"no frame came in {options.seconds:g} s. Is the bus awake? Is its bit rate right?"
            )
            raise LinkError(f"{options.channel or options.interface}: {text}")
    elif options.database and not proposal.messages_seen:
        names = ", ".join(str(path) for path in options.database)
        text = (
            "give the database of this bus, or leave --database out (then only raw bytes are used)"
        )
        raise ConfigError(
            f"{names}: the {recording.frames} frames contain no message of this database; {text}"
        )
    if not any(choice.sources for choice in proposal.choices):
        text = (
            "no signal could be recognised, so nothing is written; give a recording of some "
            "minutes with stops and bends, or a database that names its signals (--database)"
        )
        raise ConfigError(text)


def _outcome(proposal: Proposal, options: argparse.Namespace) -> str:
    count = len(proposal.choices)
    unsure = sum(not choice.is_sure for choice in proposal.choices)
    found = f"{counted(count, 'quantity', 'quantities')}, {unsure or 'none'} unsure\n"
    if proposal.missing:
        missing = (
            n.replace("_", " ") + (f" ({why})" if why else "")
            for n, why in proposal.missing.items()
        )
        found += f"not found: {', '.join(missing)}\n"
    accelerometer = proposal.choice("accelerometer")
    if accelerometer is None:
        return found + (
            "no accelerometer was found, but imucald needs one: write it into the file by hand"
        )
    doubt = f"the accelerometer is unsure ({accelerometer.doubt})\n" if accelerometer.doubt else ""
    arguments = ["--config", options.out, *options.logs]
    if not options.logs and options.interface:
        arguments += ["--interface", options.interface]
    if not options.logs and options.channel:
        arguments += ["--channel", options.channel]
    return f"{found}{doubt}next: imucald check {shlex.join(arguments)}"


def _read(logs: list[str], databases: Mapping[str, Database]) -> GatheredFrames:
    from imucald.can.logs.log_reader import LogReader
    from imucald.commands.terminal import progress_bar
    from imucald.discovery import GatheredFrames
    from imucald.discovery.candidates import stated_cycles

    with progress_bar("init") as progress:
        reader = LogReader(logs, None, False, progress, list(stated_cycles(databases)))
        recording = GatheredFrames.from_chunks(reader)
    print_problems(reader.problems)
    return recording


def _listen(options: argparse.Namespace, databases: Mapping[str, Database]) -> GatheredFrames:
    from imucald.can.link.link import Link
    from imucald.commands.check import listen
    from imucald.config_check import EVERY_FRAME
    from imucald.discovery import GatheredFrames

    interface, channel = options.interface, options.channel
    if interface is None or channel is None:  # a single name is an interface of the kernel
        interface, channel = "socketcan", interface or channel
    fd = any(m.is_fd for d in databases.values() for m in d.messages.values())
    recording = GatheredFrames()
    listen(
        Link(interface, channel, receive=EVERY_FRAME, fd=fd), options.seconds, recording.add_chunk
    )
    return recording
