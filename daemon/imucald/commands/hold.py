"""`imucald hold`: keep the active mount and stop learning."""

from __future__ import annotations

import argparse

from imucald.commands.orders import add_target, give


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `hold`."""
    add_target(
        parser,
        "A hold continues after a restart. Data recorded during a hold is ignored. If the drive "
        "contradicts a held mount, the state becomes suspect.",
    )


def run(options: argparse.Namespace) -> int:
    """Send the order to the daemon."""
    return give(options, "hold")
