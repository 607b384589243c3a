"""The table of causes in docs/diagnosis.md has the causes that the program knows."""

from __future__ import annotations

import re

import pytest

from imucald.diagnosis.causes import CAUSES, PARAMETERS, Cause
from paths import ROOT

PAGE = (ROOT / "docs" / "diagnosis.md").read_text()


def documented() -> dict[str, str]:
    """The cell of the parameters of each row, by the names in the row's first cell."""
    table = PAGE.partition("\n## Causes\n")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| (`[^|]+) \| ([^|]+) \|", table, re.M)
    return {name: cell for first, cell in rows for name in re.findall(r"`(\w+)`", first)}


def key_of(parameter: str) -> str:
    """The key of the model file of a parameter, without axis or index."""
    return (
        parameter if parameter.startswith("mount.turn") else re.sub(r"\.[xyz0-5]$", "", parameter)
    )


@pytest.mark.parametrize("cause", CAUSES, ids=lambda cause: cause.name)
def test_each_cause_has_a_row_with_its_parameters(cause: Cause) -> None:
    assert cause.name in documented(), "add its row to the table in docs/diagnosis.md"
    cell = documented()[cause.name]
    for parameter in (p for variant in cause.variants for p in variant):
        assert parameter in PARAMETERS
        key = key_of(parameter)
        assert f"`{key}`" in cell or f"`.{key.rpartition('.')[2]}`" in cell, key
