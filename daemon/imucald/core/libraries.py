"""Libraries of others: how an optional one is installed, and imports without what it would load."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType


def how_to_install(extra: str) -> str:
    """Words for a message: the command that brings an extra of pyproject.toml."""
    return f"pip install '.[{extra}]' in imucald's checkout"


@contextmanager
def standing_in(name: str, module: ModuleType | None) -> Iterator[None]:
    """Let another module stand for one while the body imports; None: as if it were not installed.

    Whoever imports it later gets it whole. One that is loaded already stays as it is.
    """
    if name in sys.modules:
        yield
        return
    sys.modules[name] = module  # type: ignore[assignment]
    try:
        yield
    finally:
        del sys.modules[name]
