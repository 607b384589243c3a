"""How an optional part is installed, in the one form that holds before there is a release."""

from __future__ import annotations

PACKAGED = "/usr/lib/imucald/"
"""Where the Debian packages are."""
IN_WORKBENCH = ("live", "report")


def how_to_install(extra: str) -> str:
    """Words for a message: the command that brings an extra of pyproject.toml."""
    if __file__.startswith(PACKAGED):
        if extra in IN_WORKBENCH:
            return "install the Debian package imucald-workbench"
        return f"no Debian package contains it; in a Python environment: pip install '.[{extra}]'"
    return f"pip install '.[{extra}]' in imucald's checkout"
