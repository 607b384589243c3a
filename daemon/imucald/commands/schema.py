"""`imucald schema`: print the JSON schema of the configuration or the model file, for editors."""

from __future__ import annotations

import argparse

CONFIGURATION, MODEL = "imucald.schema.json", "imucald-model.schema.json"
"""File names of the schemas, which are written next to the YAML files."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `schema`."""
    parser.add_argument(
        "--model", action="store_true", help="print the schema of the model file instead"
    )


def run(options: argparse.Namespace) -> int:
    """Print the schema."""
    print(schema_text(MODEL if options.model else CONFIGURATION), end="")
    return 0


def schema_text(of: str) -> str:
    """Return the content of a schema file, by its name."""
    import json

    from imucald.can.e2e.checksums import KINDS, NO_CHECKSUM, ONE_BYTE_KINDS
    from imucald.config import json_schema

    if of == MODEL:
        from imucald.config.schema import described_schema
        from imucald.model.model import VehicleModel

        return json.dumps(described_schema(VehicleModel, {}), indent=2) + "\n"
    choices = {
        ("ChecksumSettings", "kind"): [NO_CHECKSUM, *KINDS],
        ("Output", "checksum"): [NO_CHECKSUM, *ONE_BYTE_KINDS],
    }
    return json_schema(choices) + "\n"
