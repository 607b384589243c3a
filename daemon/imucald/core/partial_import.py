"""Imports without what a library would load besides, where that is worth more than milliseconds."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType


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
