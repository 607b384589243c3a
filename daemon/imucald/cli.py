"""The command line: `imucald COMMAND`. Thin: every command lives in a module of its own.

Modules are imported when their command is asked for, so that `imucald run` starts without what it
does not need. Exit status: 0 done, 1 an error that the text on stderr explains, 2 wrong usage, 78 a
wrong configuration of `run`, 130 Ctrl-C.
"""

from __future__ import annotations

import argparse
import atexit
import gc
import importlib
import os
import sys
from collections.abc import Sequence
from types import ModuleType

from imucald import __version__
from imucald.core.errors import ImucaldError

PROCESS_SETTINGS = {
    "OPENBLAS_NUM_THREADS": "1",  # matrices are small: threads cost more time than they save
    "OMP_NUM_THREADS": "1",
}
"""Set for this process, where the user has not; read when numpy is imported."""

LARGE_LIBRARIES = ("scipy",)
"""Needed for simulation and diagnosis only: an installation on a vehicle may lack them."""

DEFAULT_COLUMNS = 80
"""Width of help texts where there is no terminal."""

GC_THRESHOLD = 50_000
"""Containers made before the collector looks for cycles: starting makes many that all stay."""

COMMANDS = {
    "run": "calibrate on a live bus and send corrected frames",
    "status": "ask a running daemon how it is",
    "monitor": "watch a running daemon",
    "events": "list what happened to a running daemon, with times",
    "reset": "have a running daemon forget the mount and begin anew",
    "hold": "have a running daemon keep its mount and learn nothing",
    "release": "have a running daemon learn again after a hold",
    "set-mount": "put a mount that is known in force in a running daemon",
    "metrics": "write or serve the metrics of the running daemons for Prometheus",
    "replay": "the same from recorded logs, as fast as it goes",
    "init": "propose a configuration from a database and a recording or a bus",
    "check": "say what a configuration would decode, from a log or a live bus",
    "simulate": "write a simulated drive as a log, with its truth",
    "diagnose": "say what the simulation gets wrong beside measured drives, and why",
    "walk": "direction of travel of a carried terminal, from recorded logs",
    "draw": "draw how a sensor sits, from its angles",
    "fleet": "evaluate thousands of logs of many vehicles, and read them together",
    "demo": "see a calibration converge, without hardware",
    "install-service": "put the systemd unit and its companions in place",
    "schema": "print the JSON schema of the configuration",
}


def build_parser(command: str | None = None) -> argparse.ArgumentParser:
    """Return the parser; only the named command's options are loaded (all without one)."""
    parser = argparse.ArgumentParser(
        prog="imucald",
        description="Finds out how an inertial sensor sits in a vehicle, from what the CAN bus "
        "tells, and sends its signals corrected to vehicle axes.",
        epilog="'imucald COMMAND --help' tells more. First steps: imucald demo.",
        formatter_class=_formatter,
    )
    parser.add_argument("--version", action="version", version=f"imucald {__version__}")
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, text in COMMANDS.items():
        about = f"{text[0].upper()}{text[1:]}."
        sub = subparsers.add_parser(name, help=text, description=about, formatter_class=_formatter)
        if command is None or name == command:
            _command(name).add_arguments(sub)
    return parser


def _formatter(prog: str) -> argparse.HelpFormatter:
    """As argparse makes it, for every option; its way to the width loads compression (2 ms)."""
    try:
        columns = int(os.environ.get("COLUMNS", "")) or DEFAULT_COLUMNS
    except ValueError:
        try:
            columns = os.get_terminal_size(sys.__stdout__.fileno()).columns  # type: ignore[union-attr]
        except (AttributeError, OSError, ValueError):
            columns = DEFAULT_COLUMNS
    return argparse.HelpFormatter(prog, width=columns - 2)


def _command(name: str) -> ModuleType:
    return importlib.import_module(f"imucald.commands.{name.replace('-', '_')}")


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of the `imucald` command; returns the exit status."""
    gc.set_threshold(GC_THRESHOLD)
    atexit.register(gc.freeze)  # what ends with the process need not be searched for cycles
    arguments = list(sys.argv[1:] if argv is None else argv)
    for name, value in PROCESS_SETTINGS.items():
        os.environ.setdefault(name, value)
    named = next((a for a in arguments if a in COMMANDS), "")
    parser = build_parser(named)
    options = parser.parse_args(arguments)
    module = _command(options.command)
    try:
        return int(module.run(options))
    except ImucaldError as error:
        print(f"imucald: {error}", file=sys.stderr)
        return 1
    except ModuleNotFoundError as error:
        library = (error.name or "").partition(".")[0]
        if library not in LARGE_LIBRARIES:
            raise
        text = f"needs {library}, which is not installed here (the .deb leaves it out)"
        print(f"imucald: {options.command} {text}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("imucald: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:
        # whoever read our output has had enough; what is still buffered must not fail again
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


if __name__ == "__main__":
    sys.exit(main())
