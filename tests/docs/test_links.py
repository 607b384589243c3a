"""Links lead to files and headings that exist; pictures are those that their commands make."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from paths import ROOT

PAGES = [
    ROOT / "README.md",
    ROOT / "CHANGELOG.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "benchmarks").glob("*.md")),
    *sorted((ROOT / "benchmarks" / "records").glob("*.md")),
    ROOT / "tests" / "publications" / "README.md",
]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_page_installs_from_an_index_that_does_not_have_the_package(page: Path) -> None:
    found = re.findall(r"pip install '?\"?imucald\b.*", page.read_text())
    assert found == []


def anchors(page: Path) -> set[str]:
    """Anchors of a page: headings in lower case, blanks as hyphens, without other signs."""
    text = re.sub(r"^( *)```.*?^\1```", "", page.read_text(), flags=re.M | re.S)
    found: dict[str, int] = {}
    for heading in re.findall(r"^#+ (.*?) *#*$", text, re.M):
        plain = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading).lower()
        slug = re.sub(r"[^\w\- ]", "", plain).replace(" ", "-")
        found[slug] = found.get(slug, -1) + 1
    return {slug if n == 0 else f"{slug}-{n}" for slug, m in found.items() for n in range(m + 1)}


def links(page: Path) -> list[tuple[str, str]]:
    """File and anchor of each link within the project."""
    text = re.sub(r"^( *)```.*?^\1```|`[^`\n]*`", "", page.read_text(), flags=re.M | re.S)
    found = re.findall(r"\]\(([^)#\s]*)(?:#([^)\s]*))?\)", text)
    return [(file, anchor) for file, anchor in found if not re.match(r"\w+:", file)]


def test_anchors_are_made_as_forges_make_them(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# Safety: what a consumer must check\n## `raw`\n## raw\n```\n# no\n```\n")
    assert anchors(page) == {"safety-what-a-consumer-must-check", "raw", "raw-1"}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_no_link_is_dead(page: Path) -> None:
    for file, anchor in links(page):
        target = page.parent / file if file else page
        assert target.exists(), file
        if anchor:
            assert anchor in anchors(target), f"{file}#{anchor}"


def test_a_dead_link_would_be_seen(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# A\n[x](b.md) and [y](#a), not [z](https://example.org) nor `[k](l.md)`\n")
    assert links(page) == [("b.md", ""), ("", "a")]
    with pytest.raises(AssertionError, match=r"b\.md"):
        test_no_link_is_dead(page)


def test_every_picture_names_the_command_that_makes_it() -> None:
    pictures = sorted((ROOT / "docs").glob("*.svg"))
    assert {p.name for p in pictures} >= {"axes.svg", "demo.svg", "integrity.svg", "sits.svg"}
    for picture in pictures:
        (command,) = re.findall(r"<metadata>(.*?)</metadata>", picture.read_text())
        assert re.match(r"imucald (draw|demo) |python -m benchmarks\.", command), picture.name
