"""README.md here: the row of every claim names code, keys and a test, and all of them exist."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import msgspec
import pytest

from imucald.config import Config
from paths import ROOT

PAGE = ROOT / "tests" / "publications" / "README.md"
SECTIONS = {"A": "calibration", "B": "attitude", "C": "attitude", "D": "travel_direction"}
ROWS = {"A": 12, "B": 9, "C": 14, "D": 13}


def rows(letter: str) -> list[list[str]]:
    """Cells of the rows of a method's claims."""
    section = re.split(r"^## ", PAGE.read_text(), flags=re.M)
    (text,) = (part for part in section if part.startswith(f"{letter}. "))
    table = text[text.index("file: function") :].split("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table]


ALL = [(letter, row) for letter in SECTIONS for row in rows(letter)]
IDS = [f"{letter}-{row[0][:20]}" for letter, row in ALL]


def names(path: Path) -> set[str]:
    """Functions and classes of a file, methods with their class."""
    found = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        if isinstance(node, ast.ClassDef):
            found |= {f"{node.name}.{f.name}" for f in node.body if isinstance(f, ast.FunctionDef)}
    return found


def is_key(path: str) -> bool:
    kind = Config
    for part in path.split("."):
        fields = {f.encode_name: f for f in msgspec.structs.fields(kind)}
        if part not in fields:
            return False
        kind = fields[part].type
    return True


TESTS = {
    name
    for path in (ROOT / "tests").rglob("test_*.py")
    for name in re.findall(r"^def (test_\w+)", path.read_text(), re.M)
}


@pytest.mark.parametrize(("letter", "row"), ALL, ids=IDS)
def test_code_keys_and_test_of_a_row_exist(letter: str, row: list[str]) -> None:
    _, _, here, code, keys, tests = row
    if code == "none":
        assert here.startswith("not there")
        return
    places = re.findall(r"`([^`]+)`", code)
    assert places
    for place in places:
        file, _, name = place.partition(": ")
        assert name in names(ROOT / "daemon" / "imucald" / file), place
    for key in re.findall(r"`([^`]+)`", keys):
        assert is_key(key if key.startswith("signals.") else f"{SECTIONS[letter]}.{key}"), key
    named = re.findall(r"`([^`]+)`", tests)
    assert named
    assert set(named) <= TESTS, named


@pytest.mark.parametrize(("letter", "count"), ROWS.items())
def test_every_claim_has_a_row(letter: str, count: int) -> None:
    assert len(rows(letter)) >= count


@pytest.mark.parametrize(("letter", "row"), ALL, ids=IDS)
def test_a_row_says_which_part_is_the_same_and_which_is_not(letter: str, row: list[str]) -> None:
    here = row[2].lower()
    words = [w for w in ("same", "beyond", "reconstructed") if re.search(rf"\b{w}\b", here)]
    if len(words) > 1:
        assert all(f"{w}:" in here or f"{w} (" in here for w in words), here
