"""The compiled part for fuzzing: clang's coverage, so that libFuzzer sees its branches, and its
sanitizers, which end the process at the first byte outside an array and at undefined behaviour.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sysconfig
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

FOLDER = "IMUCALD_FUZZ_NATIVE"
"""Names the folder of the library to a process that fuzzes."""
FLAGS = [
    *("-std=c11", "-O1", "-g", "-fPIC", "-fvisibility=hidden"),
    *("-fno-fast-math", "-ffp-contract=off"),
    "-fsanitize=address,undefined,fuzzer-no-link",
    "-fno-sanitize-recover=undefined",
]
ENTRIES = ["log", "bus_frames", "frame_check", "replayed_drive"]
"""Those whose bytes the compiled part sees."""
SANITIZER = {
    # Python keeps memory up to its end: what is left then is no leak
    "ASAN_OPTIONS": "detect_leaks=0:allocator_may_return_null=1:quarantine_size_mb=64",
    "UBSAN_OPTIONS": "print_stacktrace=1",
    "PYTHONMALLOC": "malloc",  # so that the bytes of an object end where its memory ends
}


def missing() -> str:
    """What is not there of what `build` needs; "" where all is."""
    if shutil.which("clang") is None:
        return "there is no clang"
    if not Path(sysconfig.get_path("include"), "Python.h").exists():
        return "there are no headers of Python"
    return ""


def build(folder: Path) -> None:
    """Build the library into a folder; raises CalledProcessError.

    It is linked without the sanitizers: those of atheris are in the process already.
    """
    from imucald.core import compiled

    folder.mkdir(parents=True, exist_ok=True)
    stamp, headers = compiled.stamp(compiled.SOURCES), sysconfig.get_path("include")
    defined = [f"-DSTAMP={stamp}ul", f"-I{headers}"]
    objects = []
    for source in sorted(compiled.SOURCES.glob("*.c")):
        objects.append(str(folder / f"{source.stem}.o"))
        made = ["clang", "-c", *FLAGS, *defined, str(source), "-o", objects[-1]]
        subprocess.run(made, check=True)
    library = folder / (compiled.NAME + EXTENSION_SUFFIXES[0])
    subprocess.run(["clang", "-shared", *objects, "-lm", "-o", str(library)], check=True)


def environment(folder: Path) -> dict[str, str]:
    """The environment of a process that fuzzes with the library of a folder."""
    spec = importlib.util.find_spec("atheris")
    assert spec is not None
    assert spec.origin is not None
    runtime = Path(spec.origin).parents[1] / "asan_with_fuzzer.so"
    return os.environ | SANITIZER | {FOLDER: str(folder), "LD_PRELOAD": str(runtime)}


def use(folder: Path) -> None:
    """Have this process use the library of a folder."""
    from imucald.core import compiled

    compiled.kernels, compiled.state = compiled.load(folder)
    if compiled.kernels is None:
        raise SystemExit(f"compiled part of {folder}: {compiled.state}")
