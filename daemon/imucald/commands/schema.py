"""`imucald schema`: the configuration's JSON schema, for editors and checkers."""

from __future__ import annotations

import argparse


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """`schema` takes no options."""


def run(options: argparse.Namespace) -> int:
    """Print the schema."""
    from imucald.can.e2e.checksums import KINDS
    from imucald.config import json_schema

    print(json_schema({("ChecksumSettings", "kind"): ["none", *KINDS]}))
    return 0
