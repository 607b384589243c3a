"""`imucald reset`: forget the learnt mount and begin again."""

from __future__ import annotations

import argparse

from imucald.commands.orders import add_target, give


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `reset`."""
    add_target(
        parser,
        "The learnt and the saved mount are discarded. This cannot be undone. A mount that the "
        "configuration states ('calibration: mount') is used again after the reset.",
    )


def run(options: argparse.Namespace) -> int:
    """Send the order to the daemon."""
    return give(options, "reset")
