"""The contents list of a page leads to its sections."""

from __future__ import annotations

from html_page import Page
from imucald.report.page import PLACE, with_contents
from paths import ROOT

TEMPLATES = ROOT / "daemon" / "imucald" / "report" / "templates"


def links_and_headings(text: str) -> tuple[list[str], list[str]]:
    tags = Page(text).tags
    links = [a["href"] for tag, a in tags if tag == "a" and (a.get("href") or "").startswith("#")]
    return [str(link)[1:] for link in links], [str(a.get("id")) for tag, a in tags if tag == "h2"]


def test_every_section_is_listed_once_in_order() -> None:
    body = f"<p>first</p>{PLACE}<h2>One &amp; two</h2><h2>Same</h2><h2>Same</h2>"
    links, headings = links_and_headings(with_contents(body))
    assert links == headings == ["one-two", "same", "same-2"]
    assert Page(with_contents(body)).text.count("One & two") == 2


def test_escaped_text_makes_no_section() -> None:
    text = with_contents(f"{PLACE}<h2>A</h2><p>&lt;h2&gt;B&lt;/h2&gt;</p>")
    assert links_and_headings(text) == (["a"], ["a"])


def test_every_report_has_the_place_of_a_list_before_its_sections() -> None:
    for name in ("diagnosis.html", "fleet.html", "replay.html"):
        text = (TEMPLATES / name).read_text()
        assert text.count(PLACE) == 1
        assert text.index(PLACE) < text.index("<h2>")
    assert (
        ".contents { display: none; }"
        in ((TEMPLATES / "report.css").read_text().partition("@media print")[2])
    )
