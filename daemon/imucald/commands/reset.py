"""`imucald reset`: forget the learnt mount and begin again."""

from __future__ import annotations

import argparse

from imucald.commands.orders import add_target, give


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `reset`."""
    add_target(parser, " The learnt and the saved mount are discarded; this cannot be undone.")


def run(options: argparse.Namespace) -> int:
    """Give the order."""
    return give(options, "reset")
