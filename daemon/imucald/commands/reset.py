"""`imucald reset`: forget the learnt mount and begin again."""

from __future__ import annotations

import argparse

from imucald.commands.orders import add_target, give


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `reset`."""
    add_target(parser, " What was learnt and saved is set aside; it cannot be taken back.")


def run(options: argparse.Namespace) -> int:
    """Give the order."""
    return give(options, "reset")
