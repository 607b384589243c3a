"""`imucald schema`: the configuration's JSON schema, for editors and checkers."""

from __future__ import annotations

import argparse


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """`schema` takes no options."""


def run(options: argparse.Namespace) -> int:
    """Print the schema."""
    from imucald.can.e2e.checksums import KINDS, NO_CHECKSUM, ONE_BYTE_KINDS
    from imucald.config import json_schema

    choices = {
        ("ChecksumSettings", "kind"): [NO_CHECKSUM, *KINDS],
        ("Output", "checksum"): [NO_CHECKSUM, *ONE_BYTE_KINDS],
    }
    print(json_schema(choices))
    return 0
