"""Coverage-guided fuzzing of every entry: `./try python tests/fuzz [ENTRY ...] --seconds 60`.

Inputs that reach new code go to a folder outside the project (--work); `--keep` merges the few
that are needed for the same coverage into tests/fuzz/corpus, which the test suite replays.
An input that breaks something is written to the work folder and outcome. Needs atheris (extra dev).
With --native the compiled part is there with coverage and sanitizers of its own; needs clang too.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import shlex
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path

import native

HERE = Path(__file__).parent
CORPUS = HERE / "corpus"
NAMES = [
    "configuration",
    "model",
    "database",
    "log",
    "packed_log",
    "mf4_log",
    "capture",
    "file_names",
    "expression",
    "saved_state",
    "saved_dtcs",
    "isotp_frames",
    "status_request",
    "control_order",
    "bus_frames",
    "reload",
    "frame_check",
    "wrong_keys",
    "replayed_drive",
]
ITSELF = "IMUCALD_FUZZ_ITSELF"
"""Names a program that libFuzzer starts as itself: a merge runs inputs in other processes."""
INPUT_S, MEMORY_MB, LONGEST = 10, 2048, 65536
"""Limits of one input: time [s], memory [MB], length [bytes]."""
SHADOW = 2
"""So much more time and memory an input takes with sanitizers."""
ROUND, ROUNDS = 100_000, {"replayed_drive": 500}
"""Inputs of one process: atheris (3.0) keeps the outcome of each comparison of a numpy array that
it traces, some 4 kB an input of `log`, 2 MB of a replay, and the memory limit is that of the whole
process."""


Target = Callable[[bytes], None]


def load() -> dict[str, Target]:
    """Import what is fuzzed, with coverage; it takes some 15 s.

    With --native the coverage is that of the compiled part: traced Python would take most of the
    time that one input may take.
    """
    import atheris

    sys.path.insert(0, str(HERE))
    sys.path.insert(0, str(HERE.parent))
    folder = os.environ.get(native.FOLDER)
    with contextlib.nullcontext() if folder else atheris.instrument_imports(include=["imucald"]):
        from targets import TARGETS
    if folder:
        native.use(Path(folder))
    return TARGETS


def fuzz_here(target: Target, arguments: list[str]) -> None:
    """Run libFuzzer on one entry in this process; does not return."""
    import atheris

    target(b"")  # libraries that the first input loads may take longer than one input has
    atheris.Setup([os.environ.get(ITSELF, sys.argv[0]), *arguments], target)
    atheris.Fuzz()


def fuzz_in_child(target: Target, arguments: list[str], log: Path) -> int:
    """Run libFuzzer on one entry in a copy of this process; its exit status, negative: a signal."""
    sys.stdout.flush()
    if (child := os.fork()) == 0:
        output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(output, 1)
        os.dup2(output, 2)
        try:
            fuzz_here(target, arguments)
        except BaseException:
            traceback.print_exc()
        os._exit(1)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def command(name: str, *arguments: str) -> list[str]:
    """The command line of one entry's process."""
    return [sys.executable, str(Path(__file__)), "--entry", name, "--", *arguments]


def fuzz(name: str, target: Target, work: Path, seconds: int) -> bool:
    """Fuzz one entry for some seconds; whether nothing broke."""
    more = SHADOW if native.FOLDER in os.environ else 1
    found, broken = work / name, work / "broken" / name
    found.mkdir(parents=True, exist_ok=True)
    broken.mkdir(parents=True, exist_ok=True)
    log = work / f"{name}.txt"
    began = time.monotonic()
    inputs, status, left = 0, 0, seconds
    while status == 0 and left > 0:
        arguments = [
            f"-max_total_time={left}",
            f"-runs={ROUNDS.get(name, ROUND)}",
            f"-timeout={more * INPUT_S}",
            f"-rss_limit_mb={more * MEMORY_MB}",
            f"-max_len={LONGEST}",
            f"-artifact_prefix={broken}/",
            "-print_final_stats=1",
            str(found),
            str(CORPUS / name),
        ]
        status = fuzz_in_child(target, arguments, log)
        lines = log.read_text(errors="replace").splitlines()
        runs = [line for line in lines if line.startswith("stat::number_of_executed_units")]
        inputs += int(runs[0].split()[-1]) if runs else 0
        left = seconds - math.ceil(time.monotonic() - began)
    outcome = "ok" if status == 0 else f"BROKEN, see {log} and {broken}"
    print(
        f"{name:16s} {time.monotonic() - began:6.0f} s  {inputs:9d} inputs"
        f"  {len(list(found.iterdir())):5d} new  {outcome}",
        flush=True,
    )
    return status == 0


def keep(name: str, work: Path) -> None:
    """Merge what is needed for the coverage into the kept corpus."""
    (CORPUS / name).mkdir(parents=True, exist_ok=True)
    itself = work / f"{name}.sh"
    itself.write_text(f'#!/bin/sh\nexec {shlex.join(command(name))} "$@"\n')
    itself.chmod(0o755)
    with (work / f"{name}.merge.txt").open("wb") as output:
        subprocess.run(
            command(name, "-merge=1", f"-max_len={LONGEST}", str(CORPUS / name), str(work / name)),
            stdout=output,
            stderr=subprocess.STDOUT,
            env=os.environ | {ITSELF: str(itself)},
            check=True,
        )
    print(f"{name:16s} {len(list((CORPUS / name).iterdir()))} inputs kept")


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("entries", nargs="*", metavar="ENTRY", help=", ".join(NAMES))
    parser.add_argument("--seconds", type=int, default=60, help="for each entry")
    parser.add_argument("--work", type=Path, default=Path(tempfile.gettempdir()) / "imucald-fuzz")
    parser.add_argument("--keep", action="store_true", help="merge into the kept corpus")
    parser.add_argument(
        "--native", action="store_true", help="with coverage and sanitizers in the compiled part"
    )
    options = parser.parse_args()
    if unknown := set(options.entries) - set(NAMES):
        parser.error(f"no such entry: {', '.join(sorted(unknown))}; there are {', '.join(NAMES)}")
    entries, built = options.entries or NAMES, None
    if options.native:
        entries, built = options.entries or native.ENTRIES, options.work / "native"
        if others := set(entries) - set(native.ENTRIES):
            parser.error(f"no bytes of {', '.join(sorted(others))} reach the compiled part")
        if missing := native.missing():
            parser.error(f"--native: {missing}")
        if native.FOLDER not in os.environ:  # sanitizers must be there when a process begins
            native.build(built)
            os.execve(sys.executable, [sys.executable, *sys.argv], native.environment(built))
    targets, good = load(), True
    for name in entries:
        good &= fuzz(name, targets[name], options.work, options.seconds)
        if options.keep:
            keep(name, options.work)
    return 0 if good else 1


if __name__ == "__main__":
    if sys.argv[1:2] == ["--entry"]:
        fuzz_here(load()[sys.argv[2]], sys.argv[4:])
    sys.exit(main())
