"""What the benchmarks share: processes with their time and memory, files made once."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT.parent / "shared" / "data"
"""Measured drives; not part of the project."""
FOLDER = Path(tempfile.gettempdir()) / "imucald-benchmarks"
"""What is made once and kept."""
EXAMPLES = ROOT / "config" / "examples"
"""Configurations whose drives are simulated."""
MEASURED_DRIVES = ROOT / "benchmarks" / "measured_drives"
"""Configurations of measured drives (their logs are in DATA)."""
MIB = 1024.0
NOT_MEASURED = 1
"""Exit status of a benchmark that lacks the measured drives that it is about."""


@dataclass(frozen=True)
class Run:
    """One run of a process: wall time and processor time [s], largest memory [MiB], its output."""

    wall: float
    cpu: float
    memory: float
    output: str


def run(command: Sequence[str], variables: Mapping[str, str] | None = None) -> Run:
    """Run a whole process, start of the interpreter included. RuntimeError where it fails.

    Compiled modules and databases are kept, as in any installation; call once more than is
    measured. variables: of the environment, besides.
    """
    began = time.perf_counter()
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=ROOT,
        env=environment() | dict(variables or {}),
    )
    assert process.stdout is not None
    output = process.stdout.read()
    _, status, usage = os.wait4(process.pid, 0)
    wall = time.perf_counter() - began
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"{' '.join(command)} failed:\n{output}")
    return Run(wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / MIB, output)


def environment() -> dict[str, str]:
    """Environment of a measured process: as here, but with caches of their own."""
    found = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    caches = {"PYTHONPYCACHEPREFIX": "compiled", "CACHE_DIRECTORY": "databases"}
    return found | {name: str(FOLDER / folder) for name, folder in caches.items()}


def best(runs: Sequence[Run]) -> Run:
    """The fastest of several runs: what else the machine does can only add."""
    return min(runs, key=lambda one: one.wall)


def imucald(*arguments: str | Path) -> list[str]:
    """Command line of imucald in this interpreter."""
    return [sys.executable, "-m", "imucald", *map(str, arguments)]


def made_once(name: str, recipe: str, make: Callable[[Path], None]) -> Path:
    """A file in the temporary folder, made anew only when its recipe has changed."""
    FOLDER.mkdir(exist_ok=True)
    digest = hashlib.sha256(recipe.encode()).hexdigest()[:12]
    stem, dot, suffix = name.partition(".")
    path = FOLDER / f"{stem}-{digest}{dot}{suffix}"
    if not path.exists():
        making = path.with_name(f"making-{os.getpid()}-{path.name}")
        make(making)
        making.rename(path)
    return path


def is_here(name: str) -> bool:
    """Whether a measured drive is on this machine."""
    return (DATA / name).is_dir()


def nothing_measured(*names: str) -> int:
    """Say as the last line that these drives are absent; return the failing status."""
    what = f"{DATA} lacks {', '.join(names)}" if DATA.is_dir() else f"{DATA} is absent"
    print(f"nothing was measured: {what}, see benchmarks/measured_drives/README.md")
    return NOT_MEASURED


def verdict(is_met: bool) -> str:
    """How a bar is marked."""
    return "met" if is_met else "NOT MET"
