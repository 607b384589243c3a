"""The tables of findings in benchmarks/HISTORY.md name tests that exist."""

from __future__ import annotations

import re

import pytest

from paths import ROOT

HISTORY = ROOT / "benchmarks" / "HISTORY.md"
TESTS = ROOT / "tests"
TABLES = {
    "A new user's 46 findings": {"c": "commands", "m": "mount", "d": "diagnosis", "f": "fleet"},
    "Findings of the fidelity check": {
        "p": "publications", "c": "config", "f": "fleet", "s": "service", "tests": "",
    },
}  # fmt: skip
"""Beginning of each heading, and the short names of folders in its table."""
NAMED = re.compile(r"`((?:[\w/]+/)?test_\w+\.py)?(?:::(test_\w+))?`")


def named(heading: str) -> list[tuple[str, str]]:
    """File and name of each test in the rows below a heading; "" for a whole file."""
    section = HISTORY.read_text().partition(f"\n## {heading}")[2].partition("\n## ")[0]
    found, file = [], ""
    for row in re.findall(r"^\|.*\|$", section, re.M):
        for path, name in NAMED.findall(row):
            if path:
                first, slash, rest = path.partition("/")
                file = f"{TABLES[heading].get(first, first)}{slash}{rest}".lstrip("/")
            found.append((file, name))
    return found


@pytest.mark.parametrize("heading", TABLES)
def test_each_test_that_a_table_of_findings_names_exists(heading: str) -> None:
    tests = named(heading)
    assert len(tests) > 20
    missing = [
        f"{file}::{name}"
        for file, name in tests
        if not (TESTS / file).is_file()
        or (name and f"def {name}(" not in (TESTS / file).read_text())
    ]
    assert missing == []
