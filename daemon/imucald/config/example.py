"""The configuration of the example bus. The file is part of the package."""

from __future__ import annotations

from pathlib import Path


def example_path() -> Path:
    """Return the path of the configuration for the example bus (``imucald_example.dbc``)."""
    return Path(__file__).parent.parent / "data" / "imucald_example.yaml"
