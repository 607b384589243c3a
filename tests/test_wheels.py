"""All that the daemon needs comes as wheels for the processors of gateways: nothing is compiled."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from paths import ROOT

pytestmark = [pytest.mark.slow, pytest.mark.network]

LINUX = ("2_17", "2_28")
"""glibc of Debian 10 and older, of Debian 11 and later."""
COMPILED = ("numpy", "scipy", "msgspec")


@pytest.mark.parametrize("processor", ["x86_64", "aarch64"])
def test_there_are_wheels_of_all_run_dependencies(processor: str, tmp_path: Path) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = [*project["dependencies"], *project["optional-dependencies"]["diagnostics"]]
    platforms = [f"--platform=manylinux_{glibc}_{processor}" for glibc in LINUX]
    done = subprocess.run(
        [sys.executable, "-m", "pip", "download", "--quiet", "--only-binary=:all:", *platforms,
         "--platform=any", "--python-version=3.11", "--dest", str(tmp_path), *wanted],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if "Failed to establish a new connection" in done.stderr:
        pytest.skip("the package index cannot be reached")
    assert done.returncode == 0, done.stderr
    wheels = [path.name for path in tmp_path.iterdir()]
    assert all(name.endswith(".whl") for name in wheels)
    for name in COMPILED:
        (wheel,) = [w for w in wheels if w.startswith(f"{name}-")]
        assert f"_{processor}" in wheel
    other = {"x86_64": "aarch64", "aarch64": "x86_64"}[processor]
    assert not [name for name in wheels if other in name]
