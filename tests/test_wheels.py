"""Wheels for the processors of gateways: of all that the daemon needs, and of imucald itself with
its compiled part, built where there is no C compiler."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import zipfile
from collections.abc import Mapping
from pathlib import Path

import pytest

from paths import ROOT

pytestmark = [pytest.mark.slow, pytest.mark.network]

LINUX = ("2_17", "2_28")
"""glibc of Debian 10 and older, of Debian 11 and later."""
COMPILED = ("numpy", "scipy", "msgspec")
SOURCES = ("pyproject.toml", "setup.py", "MANIFEST.in", "README.md")
MACHINES = {"x86_64": 62, "aarch64": 183}
"""Machine of an ELF file (ELF specification, e_machine)."""
PIP = [sys.executable, "-m", "pip"]


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


@pytest.fixture(scope="module")
def zig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the compiler that the build brings, a wheel of 100 MB."""
    if not Path(sysconfig.get_path("include"), "Python.h").exists():
        pytest.skip("there is no header of Python")
    folder = tmp_path_factory.mktemp("zig")
    done = run([*PIP, "install", "--quiet", "--target", str(folder), "ziglang"], os.environ)
    if done.returncode:
        pytest.skip(f"ziglang cannot be installed: {done.stderr.strip().splitlines()[-1]}")
    return folder


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    """A copy of what a wheel is built of, without a library of this machine."""
    folder = tmp_path / "sources"
    leave_out = shutil.ignore_patterns("*.so", "__pycache__", "*.egg-info")
    shutil.copytree(ROOT / "daemon", folder / "daemon", ignore=leave_out)
    for name in SOURCES:
        shutil.copy(ROOT / name, folder)
    return folder


def run(command: list[str], environment: Mapping[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, check=False, env=environment)


def built(sources: Path, **more: str) -> tuple[Path, int]:
    """The wheel of these sources, and the machine of its compiled part."""
    target = sources.parent / "wheels"
    command = [*PIP, "wheel", "--quiet", "--no-deps", "--wheel-dir", str(target), str(sources)]
    left_out = ("CC", "IMUCALD_COMPILED", "PYTHONPATH")
    environment = {name: text for name, text in os.environ.items() if name not in left_out}
    done = run(command, environment | more)
    assert done.returncode == 0, done.stderr
    (wheel,) = target.glob("imucald-*.whl")
    with zipfile.ZipFile(wheel) as archive:
        (part,) = (name for name in archive.namelist() if "/_kernels" in name)
        head = archive.read(part)[:20]
    assert head[:4] == b"\x7fELF"
    return wheel, int.from_bytes(head[18:20], "little")


def test_without_a_c_compiler_the_build_brings_one(zig: Path, sources: Path, tmp_path: Path):
    """And the package has its compiled part in a fresh environment."""
    processor = os.uname().machine
    bare = tmp_path / "bin"
    bare.mkdir()  # a PATH without gcc
    wheel, machine = built(sources, PATH=str(bare))
    assert wheel.name.endswith(f"linux_{processor}.whl")
    assert machine == MACHINES[processor]
    venv = tmp_path / "venv"
    subprocess.run([sys.executable, "-m", "venv", str(venv)], check=True)
    python = str(venv / "bin" / "python")
    own = {name: text for name, text in os.environ.items() if name != "PYTHONPATH"}
    done = run([python, "-m", "pip", "install", "--quiet", str(wheel)], own)
    assert done.returncode == 0, done.stderr
    code = "from imucald.core import compiled; print(compiled.state, compiled.__file__)"
    done = run([python, "-c", code], own)
    state, _, file = done.stdout.strip().rpartition(" ")
    assert state == "in use", done.stdout + done.stderr
    assert Path(file).is_relative_to(venv)


def test_the_same_compiler_makes_a_wheel_for_arm64(zig: Path, sources: Path, tmp_path: Path):
    compiler = tmp_path / "cc"
    call = f"{sys.executable} -m ziglang cc -target aarch64-linux-gnu -mcpu=baseline"
    compiler.write_text(f'#!/bin/sh\nPYTHONPATH={zig} exec {call} "$@"\n')
    compiler.chmod(0o755)
    suffix = sysconfig.get_config_var("EXT_SUFFIX").replace("x86_64", "aarch64")
    wheel, machine = built(
        sources,
        CC=str(compiler),
        _PYTHON_HOST_PLATFORM="linux-aarch64",
        SETUPTOOLS_EXT_SUFFIX=suffix,
    )
    assert wheel.name.endswith("linux_aarch64.whl")
    assert machine == MACHINES["aarch64"]
    with zipfile.ZipFile(wheel) as archive:
        assert f"imucald/core/_kernels{suffix}" in archive.namelist()
