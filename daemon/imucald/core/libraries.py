"""External libraries: how to install optional libraries, and how to import a library without
unneeded parts."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType


def how_to_install(extra: str) -> str:
    """Return a text for messages with the command that installs an extra of pyproject.toml."""
    # the folder of the Debian packages
    if __file__.startswith("/usr/lib/imucald/"):
        if extra in ("live", "report"):
            return "install the Debian package imucald-workbench"
        return f"no Debian package contains it; in a Python environment: pip install '.[{extra}]'"
    return f"pip install '.[{extra}]' in imucald's checkout"


@contextmanager
def standing_in(name: str, module: ModuleType | None) -> Iterator[None]:
    """Context in which imports of the module `name` give `module` instead. With None, the module
    seems to be not installed.

    After the context, an import gives the real module. A module that is already loaded is not
    replaced.
    """
    if name in sys.modules:
        yield
        return
    sys.modules[name] = module  # type: ignore[assignment]
    try:
        yield
    finally:
        del sys.modules[name]
