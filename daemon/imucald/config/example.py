"""The configuration of the example bus, which the package carries."""

from __future__ import annotations

from pathlib import Path


def example_path() -> Path:
    """Where the configuration of the example bus (``imucald_example.dbc``) is."""
    return Path(__file__).parent.parent / "data" / "imucald_example.yaml"
