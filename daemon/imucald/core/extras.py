"""How an optional part is installed, in the one form that holds before there is a release."""

from __future__ import annotations


def how_to_install(extra: str) -> str:
    """Words for a message: the command that brings an extra of pyproject.toml."""
    return f"pip install '.[{extra}]' in imucald's checkout"
