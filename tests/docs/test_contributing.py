"""What CONTRIBUTING.md tells a developer to open is there: files, folders, names in them."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import pytest

from imucald.cli import COMMANDS
from imucald.config import Config
from imucald.core.typed import places
from paths import ROOT

PAGE = (ROOT / "CONTRIBUTING.md").read_text()
SOURCES = ("daemon", "tests", "dbc", "docs", "monitoring", "config")


def rows() -> list[tuple[str, str]]:
    """Both cells of each row of the two tables "where"."""
    text = PAGE.partition("## Words we avoid")[0]
    found = re.findall(r"^\| (.+?) \| (.+) \|$", text, re.M)
    return [row for row in found if row[1] != "where"]


@cache
def files() -> list[Path]:
    return [p for folder in SOURCES for p in sorted((ROOT / folder).rglob("*")) if p.is_file()]


def named(path: str) -> list[Path]:
    """The files that a row means by a path, which may lack its first folders."""
    if not Path(path).suffix or path.endswith("/"):
        return [p for p in files() if f"/{path.rstrip('/')}/" in str(p)]
    return [p for p in files() if str(p).endswith(f"/{path}")]


def missing(cell: str) -> list[str]:
    """What stands in backticks in a cell and is nowhere in the files of this cell."""
    tokens = re.findall(r"`([^`]+)`", cell)
    is_path = {
        token: "/" in token or bool(re.search(r"\.(py|c|md|dbc)$", token)) for token in tokens
    }
    paths = [token for token in tokens if is_path[token] and " " not in token]
    paths = [path for path in paths if not path.startswith("...")]
    lost = [path for path in paths if not named(path)]
    texts = [p.read_text(errors="replace") for path in paths for p in named(path)]
    keys = {": ".join(map(str, place)) for place in places(Config)}
    for name in tokens:
        if name in paths or name.startswith(("...", "imucald ")) or name in COMMANDS:
            continue
        module, _, attribute = name.rpartition(".")
        within = [p.read_text() for p in named(f"{module}.py")] if module else []
        is_there = any(re.search(rf"\b{attribute}\b", text) for text in within or texts)
        lost += [] if is_there or name in keys else [name]
    return lost


@pytest.mark.parametrize("row", rows(), ids=lambda row: row[0])
def test_every_name_in_a_row_is_in_a_file_of_the_row(row: tuple[str, str]) -> None:
    assert missing(row[1]) == []


def test_a_name_that_is_gone_would_be_seen() -> None:
    assert len(rows()) > 30
    assert missing("`can/nowhere.py`, `core/samples.py` (`DIMENSIONS`, `NO_SUCH_ROW`)") == [
        "can/nowhere.py",
        "NO_SUCH_ROW",
    ]
    assert missing("`output: parallel`, `signals: parallel`") == ["output: parallel"]


def test_the_files_in_the_path_of_a_frame_are_there() -> None:
    path = PAGE.partition("To\nfollow a frame")[2].partition("\n\n")[0]
    assert "inputs/taps.py" in path
    assert [p for p in re.findall(r"`([\w/]+\.py)`", path) if not named(p)] == []
