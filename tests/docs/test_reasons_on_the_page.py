"""What a mount waits for: each text of the program is explained on the page that helps."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

import pytest

from paths import ROOT

MOUNT = ROOT / "daemon" / "imucald" / "mount"
WHERE = {
    "states.py": ("waiting_for", "_first_reason", "_yaw_reason", "_level_reason", "_hard",
                  "NO_SAMPLES"),
    "alternatives.py": ("missing", "NO_TURNS"),
    "signal_checks.py": ("missing_to_be_fine", "NO_SIDES", "TURNED_SIDES",
                         "WHY_GRAVITY_MOVED", "NO_SPEED", "LATE_SPEED"),
}  # fmt: skip
"""Functions and constants whose texts are reasons."""


def pieces(tree: ast.AST) -> Iterator[str]:
    """Texts of a function or constant without its docstrings; the longest piece of an f-string."""
    parts = {
        id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in
        node.values
    }  # fmt: skip
    docs = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            found = [p.value for p in node.values if isinstance(p, ast.Constant)]
            yield max(map(str, found), key=len)
        elif isinstance(node, ast.Constant) and id(node) not in parts | docs:
            yield str(node.value)


def reasons() -> Iterator[str]:
    """Beginnings of all reasons: what stands before a colon, a semicolon or a bracket."""
    for name, wanted in WHERE.items():
        for node in ast.walk(ast.parse((MOUNT / name).read_text())):
            names = [getattr(node, "name", "")] + [
                target.id for target in getattr(node, "targets", ()) if hasattr(target, "id")
            ]
            if set(names) & set(wanted):
                for text in pieces(node):
                    beginning = re.split(r"[:;(]", text)[0].strip(" ,")
                    if len(beginning.split()) > 1 and "calibration" not in beginning:
                        yield beginning


@pytest.mark.parametrize("reason", sorted(set(reasons())))
def test_a_reason_for_waiting_stands_on_the_page_that_helps(reason: str) -> None:
    page = " ".join((ROOT / "docs" / "troubleshooting.md").read_text().split())
    assert reason in page


def test_the_reasons_are_found() -> None:
    assert {"more driving", "a speed with less delay", "a firmly fixed sensor"} <= set(reasons())
