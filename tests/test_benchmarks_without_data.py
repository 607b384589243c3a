"""Benchmarks of measured drives, run where there are none: they say so and fail."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from paths import ROOT

PARTS = ("benchmarks", "config", "dbc", "tests")
COMMANDS = (
    "attitude kingston", "attitude check", "attitude heading",
    "diagnosis --only nulls second_world",
    "init --part measured", "init --part second_world", "init --part renamed",
    "integrity --only recorded", "methods", "real_drives", "real_drives --only wrx_sti",
    "signal_forms --group second_world measured", "simulation_realism", "walk measured",
)  # fmt: skip
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy with no folder of measured drives beside it."""
    copy = tmp_path_factory.mktemp("alone") / "checkout"
    for part in PARTS:
        shutil.copytree(ROOT / part, copy / part, ignore=shutil.ignore_patterns("__pycache__"))
    return copy


@pytest.mark.parametrize("command", COMMANDS)
def test_a_benchmark_without_its_drives_measures_nothing_and_fails(
    command: str, checkout: Path, tmp_path: Path
) -> None:
    name, *options = command.split()
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(checkout), str(ROOT / "daemon")]),
        "TMPDIR": str(tmp_path),
    }
    done = subprocess.run(
        [sys.executable, "-m", f"benchmarks.{name}", *options],
        cwd=checkout, env=environment, capture_output=True, text=True, timeout=120,
        check=False,
    )  # fmt: skip
    assert done.returncode == 1, done.stderr
    last = done.stdout.splitlines()[-1]
    data = checkout.parent / "shared" / "data"
    page = "benchmarks/measured_drives/README.md"
    assert last == f"nothing was measured: {data} is absent, see {page}"
    assert (checkout / page).is_file()
