"""The figures of the pages are of drives that nothing was tuned on."""

from __future__ import annotations

import re
import shlex
from itertools import pairwise

import pytest
from benchmarks.integrity.cases import QUIET_SEEDS
from benchmarks.mount_accuracy.seeds import tuned_on

from paths import ROOT

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
COMMANDS = [
    pytest.param(command, id=f"{page.name} {command}")
    for page in PAGES
    for command in re.findall(r"python -m benchmarks\.([^`\n]+)`", page.read_text())
]
FIRST, COUNT = ("--first", "--from", "--first-seed"), ("--drives", "--seeds", "--draws")


def option(words: list[str], names: tuple[str, ...]) -> int | None:
    found = (int(value) for name, value in pairwise(words) if name in names)
    return next(found, None)


def test_commands_are_found() -> None:
    assert len(COMMANDS) > 15
    assert any("--first" in str(command.values[0]) for command in COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_on_a_page_names_no_seed_that_was_tuned_on(command: str) -> None:
    words = shlex.split(command)
    first = option(words, FIRST)
    if first is None:
        return  # the benchmark's own seeds: tests/mount/test_accuracy_seeds.py
    seeds = range(first, first + (option(words, COUNT) or 1))
    if words[0] == "integrity":
        hours = option(words, ("--hours",)) or 0
        seeds = [*seeds, *range(first + QUIET_SEEDS, first + QUIET_SEEDS + hours)]
    assert tuned_on(seeds) == []
