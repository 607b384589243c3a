"""The configuration of the example bus, which the package carries."""

from __future__ import annotations

from importlib import resources
from pathlib import Path


def example_path() -> Path:
    """Where the configuration of the example bus (``imucald_example.dbc``) is."""
    return Path(str(resources.files("imucald"))) / "data" / "imucald_example.yaml"
