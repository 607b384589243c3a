"""Every kept fuzzing input again, and a minute of new ones: nothing escapes, nothing hangs."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

from fuzz import native
from fuzz.targets import TARGETS
from paths import ROOT

FUZZ = ROOT / "tests" / "fuzz"
SECONDS = 3
KEPT = sorted(FUZZ.glob("corpus/*/*"))


@pytest.mark.parametrize("path", KEPT, ids=lambda path: f"{path.parent.name}-{path.name[:12]}")
def test_a_kept_input_is_judged_and_nothing_else_comes_of_it(path: Path):
    TARGETS[path.parent.name](path.read_bytes())


@pytest.mark.parametrize("name", TARGETS)
def test_every_entry_has_seeds(name: str):
    assert any(path.parent.name == name for path in KEPT)


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("atheris") is None, reason="atheris is not installed")
def test_some_seconds_of_new_inputs_break_nothing(tmp_path: Path):
    command = [sys.executable, str(FUZZ), "--seconds", str(SECONDS), "--work", str(tmp_path)]
    found = subprocess.run(command, capture_output=True, text=True, check=False, timeout=900)
    assert found.returncode == 0, found.stdout + found.stderr
    for name in TARGETS:
        assert (tmp_path / f"{name}.txt").stat().st_size > 0


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("atheris") is None, reason="atheris is not installed")
@pytest.mark.skipif(bool(native.missing()), reason=native.missing())
def test_sanitizers_find_nothing_in_the_compiled_part(tmp_path: Path):
    command = [sys.executable, str(FUZZ), *native.ENTRIES, "--native", "--seconds", str(SECONDS)]
    found = subprocess.run(  # one build for all entries
        [*command, "--work", str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
        timeout=900,
    )
    assert found.returncode == 0, found.stdout + found.stderr
    for name in native.ENTRIES:
        assert "Loaded 1 modules" in (tmp_path / f"{name}.txt").read_text(errors="replace")
