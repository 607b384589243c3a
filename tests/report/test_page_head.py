"""All pages have one head and one set of colours."""

from __future__ import annotations

import re

import pytest

from imucald.report.page import environment
from paths import ROOT

TEMPLATES = ROOT / "daemon" / "imucald" / "report" / "templates"
REPORTS = [p.name for p in TEMPLATES.glob("*.html") if p.name not in ("page.html", "monitor.html")]
DEFINED = re.compile(r"(--[a-z]+):")
USED = re.compile(r"var\((--[a-z]+)\)")


def text(name: str) -> str:
    return (TEMPLATES / name).read_text()


@pytest.mark.parametrize("name", REPORTS)
def test_a_report_begins_as_every_page_does(name: str) -> None:
    template = environment().get_template(name)
    blocks = {part: "".join(template.blocks[part](template.new_context())) for part in ("kind",)}
    assert blocks["kind"] in ("diagnosis", "fleet", "replay")
    assert text(name).startswith('{% extends "page.html" %}\n')
    assert "<head>" not in text(name)
    assert "<meta" not in text(name)


def test_the_page_of_the_monitor_has_the_same_colours_and_no_template_language() -> None:
    page = text("monitor.html")
    assert page.count("/* page.css */") == 1
    assert "{%" not in page
    assert "{{" not in page


@pytest.mark.parametrize(
    "sheets", [("report.css", "diagnosis.css"), ("report.css",), ("report.css", "replay.css")]
)
def test_every_colour_that_a_sheet_uses_is_defined(sheets: tuple[str, ...]) -> None:
    css = "".join(map(text, ("page.css", *sheets)))
    assert set(USED.findall(css)) <= set(DEFINED.findall(css))
    assert css.count("{") == css.count("}")


def test_no_rule_stands_in_two_sheets() -> None:
    rules: list[str] = []
    for sheet in TEMPLATES.glob("*.css"):
        top = re.sub(r"@media[^{]*\{(?:[^{}]|\{[^{}]*\})*\}", "", sheet.read_text())
        rules += re.findall(r"[^{}]+\{[^{}]*\}", top)
    cleaned = [" ".join(rule.split()) for rule in rules]
    assert len(cleaned) > 60
    assert len(set(cleaned)) == len(cleaned)
