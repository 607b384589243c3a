"""Installation of an optional part, in the one form that works before there is a release."""

from __future__ import annotations

PACKAGED = "/usr/lib/imucald/"
"""Folder of the Debian packages."""
IN_WORKBENCH = ("live", "report")


def how_to_install(extra: str) -> str:
    """Return the command that installs an extra of pyproject.toml, as words for a message."""
    if __file__.startswith(PACKAGED):
        if extra in IN_WORKBENCH:
            return "install the Debian package imucald-workbench"
        return f"no Debian package contains it; in a Python environment: pip install '.[{extra}]'"
    return f"pip install '.[{extra}]' in imucald's checkout"
