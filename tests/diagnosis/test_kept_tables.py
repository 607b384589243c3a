"""Tables that a search comes back to."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from imucald.diagnosis.fit import blocks
from imucald.diagnosis.fit.blocks import KeptTables


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Models that a table was made for, of 80 bytes each; three of them may be kept."""
    of: list[str] = []

    def table_of(drives, model):
        of.append(model)
        return SimpleNamespace(plain={}, gram=np.zeros(10)), [model]

    monkeypatch.setattr(blocks, "table_of", table_of)
    monkeypatch.setattr(blocks, "MOST_BYTES", 240)
    return of


def test_a_table_is_made_once_for_each_model(made):
    tables = KeptTables()
    first, forwards = tables.table_for((), "a")
    assert forwards == ["a"]
    assert tables.table_for((), "b")[0] is not first
    assert tables.table_for((), "a")[0] is first
    assert made == ["a", "b"]


def test_what_was_not_asked_for_the_longest_makes_room(made):
    tables = KeptTables()
    for model in "abcad":
        tables.table_for((), model)
    made.clear()
    for model in "acd":
        tables.table_for((), model)
    assert made == []
    tables.table_for((), "b")
    assert made == ["b"]


def test_a_table_larger_than_all_room_is_kept_while_it_is_the_last(made, monkeypatch):
    monkeypatch.setattr(blocks, "MOST_BYTES", 10)
    tables = KeptTables()
    for model in "aab":
        tables.table_for((), model)
    assert made == ["a", "b"]
