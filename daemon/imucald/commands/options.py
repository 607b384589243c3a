"""Options that several commands have in common."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from imucald.core.errors import ConfigError

if TYPE_CHECKING:
    from imucald.api.configuration import Configuration

LOG_HELP = (
    "candump output in any form ('-' for standard input), ASC, BLF, TRC, MF4, CSV of SavvyCAN or "
    "python-can, PCAP; may be compressed (gz, xz, bz2, zst). Best: candump -l can0"
)


def positive(text: str) -> float:
    """A finite number above zero, for an option."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not 0.0 < number < math.inf:
        raise argparse.ArgumentTypeError(f"must be a number above 0 (here: {text!r})")
    return number


def add_config(parser: argparse.ArgumentParser) -> None:
    """Which configuration, and databases in place of those that it names."""
    parser.add_argument(
        "--config",
        required=True,
        type=Path,
        metavar="FILE",
        help="configuration (YAML); 'imucald init' proposes one",
    )
    parser.add_argument(
        "--database",
        action="append",
        default=[],
        type=Path,
        metavar="FILE",
        help="database to use instead of that in the configuration (repeat for several)",
    )


def configuration(options: argparse.Namespace) -> Configuration:
    """The configuration that the options of `add_config` name; its warnings go to stderr."""
    from imucald.api.configuration import Configuration

    found = Configuration.load(options.config, options.database)
    print_problems(f"warning: {text}" for text in found.warnings)
    return found


def print_problems(texts: Iterable[str]) -> None:
    """What is wrong with a configuration or a log, a line each on stderr."""
    for text in texts:
        print(f"imucald: {text}", file=sys.stderr)


def add_quiet(parser: argparse.ArgumentParser, text: str) -> None:
    """The same two names in every command. text: what is left out."""
    parser.add_argument("--quiet", "-q", action="store_true", help=text)


def refuse_log_and_bus(options: argparse.Namespace) -> None:
    """Raise ConfigError where both a recording and a bus are named."""
    if options.logs and (options.interface or options.channel):
        raise ConfigError("give either LOG, or --interface and --channel, but not both")


def add_bus(parser: argparse.ArgumentParser) -> None:
    """Which bus, in place of the configuration's."""
    parser.add_argument("--interface", help="python-can interface (default: the configuration's)")
    parser.add_argument("--channel", help="its channel, such as can0")
