"""Words of pages and program: spelled right, and none that CONTRIBUTING.md lists as avoided."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from paths import ROOT

LIST = ROOT / "CONTRIBUTING.md"
HEADING = "## Words we avoid"
DOCS = sorted((ROOT / "docs").glob("*.md"))
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", ROOT / "CONTRIBUTING.md", *DOCS]
MOST_WORDS = 35_000
"""Words of the pages in `docs`, as `wc -w` counts. Who adds a sentence looks for one to drop."""
MODULES = sorted((ROOT / "daemon" / "imucald").rglob("*.py"))
TEMPLATES = sorted((ROOT / "daemon" / "imucald").rglob("*.html"))
SPELLED = ["README.md", "CHANGELOG.md", "CONTRIBUTING.md", "docs", "config", "dbc", "systemd",
           "deb", "benchmarks", "daemon", "try", "Containerfile"]  # fmt: skip
SPELLED_SO = "nees,endianess,informations,temperatur,fro,fo,ags"
"""Normalised estimation error squared; names of other libraries; Fisher informations."""


def avoided() -> list[str]:
    """The words of the list, left column."""
    table = LIST.read_text().partition(HEADING)[2]
    rows = re.findall(r"^\| ([a-z][^|]*) \| [^|]+ \|$", table, re.M)
    return [word.strip() for row in rows[1:] for word in row.split(",")]


def pattern() -> re.Pattern[str]:
    return re.compile(rf"\b(?:{'|'.join(map(re.escape, avoided()))})\b", re.I)


def lines_of(text: str) -> Iterator[tuple[int, str]]:
    """Numbered lines of a page without code, link targets, and names in backticks."""
    code = False
    for number, line in enumerate(text.splitlines(), 1):
        if line.lstrip().startswith("```"):
            code = not code
        elif not code and not line.startswith("    "):
            yield number, re.sub(r"`[^`]*`|\]\([^)]*\)", "", line)


def sentences(module: Path) -> Iterator[tuple[int, str]]:
    """Texts of a module that a person may read: strings of more than a word, no docstrings."""
    tree = ast.parse(module.read_text())
    docstrings = {
        id(node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }
    for node in ast.walk(tree):
        if not isinstance(node, ast.Constant) or not isinstance(node.value, str):
            continue
        if id(node) not in docstrings and " " in node.value.strip():
            yield node.lineno, node.value


def test_the_table_of_avoided_words_is_read() -> None:
    assert {"lateness", "stretch", "otherwise than", "mounting angle"} <= set(avoided())
    assert pattern().search("its Lateness here")
    assert not pattern().search("stretched; plateness")


def test_usual_words_are_not_avoided() -> None:
    """Sentences that went around them were worse than the words."""
    for text in ("it is told", "a lot", "honest", "0.3 sd", "mended", "alike", "anew", "preset"):
        assert not pattern().search(text)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_a_page_has_no_word_that_we_avoid(page: Path) -> None:
    words = pattern()
    text = page.read_text().partition(HEADING)[0]
    found = [(n, m[0]) for n, line in lines_of(text) for m in words.finditer(line)]
    assert found == []


def test_the_programs_texts_have_no_word_that_we_avoid() -> None:
    words = pattern()
    texts = [(m, n, text) for m in MODULES for n, text in sentences(m)]
    for template in TEMPLATES:
        text = re.sub(r"{[{%].*?[%}]}", "", template.read_text())
        texts += [(template, n, line) for n, line in enumerate(text.splitlines(), 1)]
    found = [(str(m.relative_to(ROOT)), n, t) for m, n, t in texts if words.search(t)]
    assert len(texts) > 1000
    assert found == []


def test_pages_and_program_are_spelled_right() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "codespell_lib", "--skip", "*.svg,*.ipynb,*.pyc,.venv",
         "--ignore-words-list", SPELLED_SO, *SPELLED],
        capture_output=True, text=True, check=False, cwd=ROOT,
    )  # fmt: skip
    assert done.stdout == ""
    assert done.returncode == 0, done.stderr


def test_the_pages_are_no_longer_than_a_user_reads() -> None:
    """Tables of measurements and history stand in `benchmarks`, what changers need elsewhere."""
    words = {page.name: len(page.read_text().split()) for page in DOCS}
    total = sum(words.values())
    longest = sorted(words, key=words.__getitem__)[-5:]
    assert total <= MOST_WORDS, f"{total} words; the longest: {longest}"


@pytest.mark.parametrize("page", DOCS, ids=lambda p: p.name)
def test_a_page_names_no_commit(page: Path) -> None:
    found = re.findall(r"\b(?=[0-9a-f]*\d)(?=[0-9a-f]*[a-f])[0-9a-f]{7,40}\b", page.read_text())
    assert found == []
