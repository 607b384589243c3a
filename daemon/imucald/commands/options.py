"""Options that several commands have in common."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

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
    parser.add_argument("--config", required=True, type=Path, metavar="FILE", help="configuration")
    parser.add_argument(
        "--database",
        action="append",
        default=[],
        type=Path,
        metavar="FILE",
        help="database to use in place of the configuration's (repeat for several)",
    )


def add_bus(parser: argparse.ArgumentParser) -> None:
    """Which bus, in place of the configuration's."""
    parser.add_argument("--interface", help="python-can interface (default: the configuration's)")
    parser.add_argument("--channel", help="its channel, such as can0")
