"""The command line: `imucald COMMAND`. Each command has its own module in `commands`; the orders to
a running daemon share one.

A module is imported only when its command is used, so that `imucald run` starts without unneeded
modules. Exit status: 0 success, 1 error (explained on stderr), 2 wrong usage, 78 wrong
configuration of `run`, 130 Ctrl-C.
"""

from __future__ import annotations

import argparse
import atexit
import errno
import gc
import importlib
import os
import signal
import sys
from collections.abc import Iterable, Sequence
from contextlib import suppress
from types import ModuleType
from typing import Any

from imucald import __version__
from imucald.commands.interrupting import ending_signal, interrupt, terminate
from imucald.core.errors import ImucaldError
from imucald.core.text import SafeStream

PROCESS_SETTINGS = {
    "OPENBLAS_NUM_THREADS": "1",  # matrices are small: threads cost more time than they save
    "OMP_NUM_THREADS": "1",
}
"""Environment variables that are set for this process unless the user has set them. numpy reads
these variables when it is imported."""

LARGE_LIBRARIES = ("scipy",)
"""Libraries that only simulation and diagnosis need. These libraries may be missing in an
installation on a vehicle."""

WRONG_USAGE = 2
DIED_OF = 128
"""If a signal ended a command, the exit status is this number plus the number of the signal."""
SIGNALS = (
    (signal.SIGINT, signal.default_int_handler, interrupt),
    (signal.SIGTERM, signal.SIG_DFL, terminate),
    *([(signal.SIGHUP, signal.SIG_DFL, terminate)] if hasattr(signal, "SIGHUP") else []),
)
"""Handled signals: signal, default action, action in imucald. Windows has no SIGHUP."""
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EIO)
"""Error numbers of a write to a disk that is full or defective."""

TOO_MANY_FILES = (errno.EMFILE, errno.ENFILE)
NO_ROOM = "failed to map segment"
"""Part of the loader's error text for a library that does not fit into the address space."""

NO_REASON = "without exception set"
"""Part of the interpreter's error text if there was not enough memory while a library was
imported."""

DEFAULT_COLUMNS = 80
"""Width of help texts if there is no terminal [columns]."""

GC_THRESHOLD = 50_000
"""Threshold of Python's garbage collector: number of new container objects before a collection. The
value is high because nearly all objects that are created at the start stay in use."""

GROUPS = {
    "try it": {
        "demo": "watch a calibration converge, without hardware",
        "simulate": "write a simulated drive as a log, with the true values",
    },
    "begin with your bus": {
        "init": "propose a configuration from a database and a recording or a bus",
        "check": (
            "check a configuration on a log or a live bus: show the decoded signals, and all errors"
        ),
        "replay": "find the mount in recorded logs, as the live daemon would",
        "draw": "draw the orientation of a sensor from its mount angles",
    },
    "run imucald in a vehicle": {
        "run": "calibrate on a live bus and send corrected frames",
        "status": "show the state of a running daemon",
        "wait": "wait until a running daemon sends corrected frames of a quality",
        "monitor": "watch a running daemon",
        "install-service": "install the systemd unit and its additional files",
    },
    "operate it": {
        "events": "list the events of a running daemon, with times",
        "reset": "let a running daemon forget the mount and start again",
        "hold": "hold the mount of a running daemon: driving does not change it",
        "release": "end a hold: the running daemon estimates the mount again",
        "set-mount": "give a known mount to a running daemon",
        "feed": "send the results of a running daemon to MQTT, KUKSA or Foxglove",
        "metrics": "write or serve the metrics of the running daemons for Prometheus",
    },
    "look closer": {
        "diagnose": "compare a simulation with measured drives, and find the causes of differences",
        "fleet": "evaluate thousands of logs of many vehicles together",
        "walk": "find the direction of travel of a carried terminal, in recorded logs",
        "schema": "print the JSON schema of the configuration",
    },
}
"""Commands grouped by purpose, in the order of the help text."""
COMMANDS = {name: text for group in GROUPS.values() for name, text in group.items()}
ORDERS = frozenset({"reset", "hold", "release", "set-mount"})
"""Commands of the module `commands.orders`."""


class _Help(argparse.HelpFormatter):
    """Help formatter that wraps paragraphs. Paragraphs that begin with a blank (examples) are not
    changed."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        parts = text.split("\n\n")
        return "\n\n".join(
            part if part.startswith(" ") else super(_Help, self)._fill_text(part, width, indent)
            for part in parts
        )


class _ByGroups(_Help):
    """Help formatter that lists commands under the headings of their groups."""

    def format_help(self) -> str:
        """Format the help with a column that is wide enough for the longest name. argparse does not
        count the indent of names."""
        self._action_max_length += 2
        return super().format_help()

    def _format_action(self, action: argparse.Action) -> str:
        text = super()._format_action(action)
        heading = next((h for h, group in GROUPS.items() if action.dest == next(iter(group))), "")
        return f"\n  {heading}:\n{text}" if heading and action.nargs is None else text


class _Parser(argparse.ArgumentParser):
    """Parser that accepts only complete option names, because an abbreviation may become ambiguous
    in a later version."""

    def __init__(self, **given: Any) -> None:
        super().__init__(**{"formatter_class": _formatter, "allow_abbrev": False, **given})


class _Version(argparse.Action):
    """Action that prints the version, and whether the compiled part is used. The compiled part is
    loaded only for this output."""

    def __init__(self, **given: Any) -> None:
        super().__init__(**{**given, "nargs": 0, "dest": argparse.SUPPRESS})

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from imucald.core import compiled  # it loads numpy

        print(f"imucald {__version__} (compiled part: {compiled.state})")
        parser.exit()


def build_parser(
    command: str | None = None, names: Iterable[str] = COMMANDS
) -> argparse.ArgumentParser:
    """Return the parser for the commands in `names`.

    command: only the options of this command are loaded; None means all commands.
    """
    parser = _Parser(
        prog="imucald",
        description="Determines the mount of an inertial sensor in a vehicle from the signals on "
        "the CAN bus, and sends the sensor's signals in vehicle axes.",
        epilog="'imucald COMMAND --help' explains a command. First step: imucald demo.",
        formatter_class=lambda prog: _formatter(prog, _ByGroups),
    )
    parser.add_argument("--version", action=_Version, help="show the version and exit")
    subparsers = parser.add_subparsers(
        title="commands", dest="command", metavar="COMMAND", required=True
    )
    for name in names:
        text = COMMANDS[name]
        about = f"{text[0].upper()}{text[1:]}."
        sub = subparsers.add_parser(name, help=text, description=about)
        if command is None or name == command:
            _command(name).add_arguments(sub)
    return parser


def _formatter(prog: str, kind: type[_Help] = _Help) -> _Help:
    """Return a help formatter with the width of the terminal. argparse itself would load
    compression modules to find this width (2 ms)."""
    try:
        columns = int(os.environ.get("COLUMNS", "")) or DEFAULT_COLUMNS
    except ValueError:
        try:
            columns = os.get_terminal_size(sys.__stdout__.fileno()).columns  # type: ignore[union-attr]
        except (AttributeError, OSError, ValueError):
            columns = DEFAULT_COLUMNS
    return kind(prog, width=columns - 2)


def _command(name: str) -> ModuleType:
    module = "orders" if name in ORDERS else name.replace("-", "_")
    return importlib.import_module(f"imucald.commands.{module}")


def _unknown_command(name: str) -> str:
    import difflib

    near = difflib.get_close_matches(name, COMMANDS, n=1)
    hint = f"did you mean '{near[0]}'? " if near else ""
    return f"imucald: there is no command '{name}'; {hint}'imucald --help' lists all commands"


def _parsed(parser: argparse.ArgumentParser, arguments: list[str]) -> argparse.Namespace:
    """Return the parsed options. An unknown option is reported with the usage of its command."""
    options, unknown = parser.parse_known_args(arguments)
    if unknown:
        (commands,) = parser._subparsers._group_actions  # type: ignore[union-attr]
        commands.choices[options.command].error(  # type: ignore[index]
            f"unrecognized arguments: {' '.join(unknown)}"
        )
    return options


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of the command `imucald`. Return the exit status."""
    streams = sys.stdout, sys.stderr
    sys.stdout = sys.stdout and SafeStream(sys.stdout)
    sys.stderr = sys.stderr and SafeStream(sys.stderr, is_for_people=True)
    taken = []
    for number, usual, handler in SIGNALS:
        if signal.getsignal(number) is usual:  # not ignored, not somebody else's
            with suppress(ValueError):  # another thread than the first may not
                taken.append((number, handler, signal.signal(number, handler)))
    try:
        return _done(argv)
    except (MemoryError, ImportError, OSError, SystemError) as error:
        if (text := _limit_words(error)) is None:
            raise
        print(f"imucald: {text}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        if died_of := ending_signal():
            return DIED_OF + died_of
        print("imucald: interrupted", file=sys.stderr)
        return 130
    finally:
        for number, handler, before in taken:
            if signal.getsignal(number) is handler:
                signal.signal(number, before)
        sys.stdout, sys.stderr = streams


def _limit_words(error: Exception) -> str | None:
    """Return a text that states which limit of this process was reached, with a remedy; None if the
    error has another cause."""
    number = error.errno if isinstance(error, OSError) else None
    if number in TOO_MANY_FILES:
        return "too many open files: raise the limit of this process (ulimit -n)"
    no_room = isinstance(error, ImportError) and NO_ROOM in str(error)
    no_room |= isinstance(error, SystemError) and NO_REASON in str(error)
    if isinstance(error, MemoryError) or number == errno.ENOMEM or no_room:
        return (
            "the memory that this process may use is full: raise its limit, or process fewer "
            "or shorter logs at once"
        )
    return None


def _done(argv: Sequence[str] | None) -> int:
    """Run the command that the arguments name. Return the exit status."""
    gc.set_threshold(GC_THRESHOLD)
    atexit.register(gc.freeze)  # what ends with the process need not be searched for cycles
    arguments = list(sys.argv[1:] if argv is None else argv)
    for name, value in PROCESS_SETTINGS.items():
        os.environ.setdefault(name, value)
    named = next((a for a in arguments if not a.startswith("-")), "")
    is_first = named in COMMANDS and arguments[0] == named  # nothing lists the other commands
    parser = build_parser(named, [named] if is_first else COMMANDS)
    if not arguments:
        parser.print_help(sys.stderr)
        return WRONG_USAGE
    if named and named not in COMMANDS:
        print(_unknown_command(named), file=sys.stderr)
        return WRONG_USAGE
    options = _parsed(parser, arguments)
    module = _command(options.command)
    try:
        return int(module.run(options))
    except ImucaldError as error:
        for line in str(error).splitlines():
            print(f"imucald: {line}", file=sys.stderr)
        return error.exit_status
    except ModuleNotFoundError as error:
        library = (error.name or "").partition(".")[0]
        if library not in LARGE_LIBRARIES:
            raise
        text = (
            f"needs the library {library}, which is not installed here (the Debian package "
            "imucald-workbench contains it)"
        )
        print(f"imucald: {options.command} {text}", file=sys.stderr)
        return 1
    except BrokenPipeError:
        # whoever read our output has had enough; what is still buffered must not fail again
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        if error.errno not in FULL or error.filename is not None:
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        print(f"imucald: the output cannot be written: {error.strerror}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
