"""`imucald release`: learn the mount again after a hold."""

from __future__ import annotations

import argparse

from imucald.commands.orders import add_target, give


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `release`."""
    add_target(
        parser,
        "A hold that the configuration states ('calibration: mount: hold: true') cannot be "
        "released by this command: remove it from the configuration, then reload.",
    )


def run(options: argparse.Namespace) -> int:
    """Send the order to the daemon."""
    return give(options, "release")
