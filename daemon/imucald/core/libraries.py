"""External libraries: installation of an optional one, and imports without unneeded parts."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType

PACKAGED = "/usr/lib/imucald/"
"""Folder of the Debian packages."""
IN_WORKBENCH = ("live", "report")
"""Extras that the package imucald-workbench has."""


def how_to_install(extra: str) -> str:
    """Return the command that installs an extra of pyproject.toml, as words for a message."""
    if __file__.startswith(PACKAGED):
        if extra in IN_WORKBENCH:
            return "install the Debian package imucald-workbench"
        return f"no Debian package contains it; in a Python environment: pip install '.[{extra}]'"
    return f"pip install '.[{extra}]' in imucald's checkout"


@contextmanager
def standing_in(name: str, module: ModuleType | None) -> Iterator[None]:
    """Replace a module by another one during the imports in the body; None: as if it were not
    installed.

    A later import gets the real module. A module that is already loaded stays as it is.
    """
    if name in sys.modules:
        yield
        return
    sys.modules[name] = module  # type: ignore[assignment]
    try:
        yield
    finally:
        del sys.modules[name]
