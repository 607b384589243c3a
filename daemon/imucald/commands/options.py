"""Options that several commands use."""

from __future__ import annotations

import argparse
import math
import re
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
    """Parse a finite number above zero, for an option."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not 0.0 < number < math.inf:
        raise argparse.ArgumentTypeError(f"must be a number above 0 (here: {text!r})")
    return number


def numbers(text: str) -> list[float]:
    """Return the finite numbers of a text with commas between them; empty if a part is none."""
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        return []
    return found if all(map(math.isfinite, found)) else []


def allow_negative_numbers(parser: argparse.ArgumentParser) -> None:
    """Make "-5,3,30" the value of an option; argparse would read it as an option itself."""
    parser._negative_number_matcher = re.compile(r"^-[\d.][\d.,e+-]*$")


def add_mount(parser: argparse.ArgumentParser) -> None:
    """Add the option for the mount of a simulated car."""
    allow_negative_numbers(parser)
    parser.add_argument(
        "--mount", metavar="R,P,Y", help="mount angles in degrees (default: drawn from the seed)"
    )


def add_config(parser: argparse.ArgumentParser) -> None:
    """Add the options for the configuration, and for databases that replace the databases of the
    configuration."""
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
        help="database that replaces the database of the configuration (repeat for several)",
    )


def configuration(options: argparse.Namespace) -> Configuration:
    """Load the configuration that the options of `add_config` name; print warnings on stderr."""
    from imucald.api.configuration import Configuration

    found = Configuration.load(options.config, options.database)
    print_problems(f"warning: {text}" for text in found.warnings)
    return found


def print_problems(texts: Iterable[str]) -> None:
    """Print problems of a configuration or a log on stderr, one line each."""
    for text in texts:
        print(f"imucald: {text}", file=sys.stderr)


def add_strict(parser: argparse.ArgumentParser) -> None:
    """Add the option that makes the first bad line of a log an error."""
    parser.add_argument("--strict", action="store_true", help="stop at the first bad line")


def add_quiet(parser: argparse.ArgumentParser, text: str) -> None:
    """Add the option for quiet output, with the same names in all commands. text: its help."""
    parser.add_argument("--quiet", "-q", action="store_true", help=text)


def refuse_log_and_bus(options: argparse.Namespace) -> None:
    """Raise ConfigError if both a recording and a bus are given."""
    if options.logs and (options.interface or options.channel):
        raise ConfigError("give either LOG, or --interface and --channel, but not both")


def add_bus(parser: argparse.ArgumentParser) -> None:
    """Add the options for a bus that replaces the configured bus."""
    parser.add_argument("--interface", help="python-can interface (default: the configuration's)")
    parser.add_argument("--channel", help="channel of this interface, such as can0")
