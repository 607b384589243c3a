"""A module stands in for another while something is imported, and only then."""

from __future__ import annotations

import importlib
import sys
from types import ModuleType

import pytest

from imucald.core.libraries import standing_in


def test_a_module_is_absent_in_the_body_and_there_afterwards(monkeypatch):
    monkeypatch.delitem(sys.modules, "antigravity", raising=False)
    with standing_in("antigravity", None), pytest.raises(ImportError):
        importlib.import_module("antigravity")
    assert "antigravity" not in sys.modules
    other = ModuleType("antigravity")
    with standing_in("antigravity", other):
        assert importlib.import_module("antigravity") is other
    assert "antigravity" not in sys.modules


def test_a_loaded_module_stays():
    with standing_in("json", None):
        assert importlib.import_module("json") is sys.modules["json"]
    assert sys.modules["json"] is not None
