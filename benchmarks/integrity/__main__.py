"""Is what is sent ever good and wrong? The figures of benchmarks/records/integrity.md.

    python -m benchmarks.integrity [--only PART ...] [--row NAME ...] [--base BASE ...]
                                   [--drives N] [--hours N] [--logs N] [--first SEED] [--jobs N]
                                   [--quick] [--results FILE] [--table] [--worst N]
                                   [--diagram FILE] [--write]

Faults are edited into the samples of simulated drives and measured logs; frames are made of them
and taken through the real engine; what it sends is held against the truth. Each drive's outcome is
one line of JSON in the results file, which is named after the daemon's and the judge's code: a run
that was broken off goes on where it stopped, and a changed daemon begins anew. Exit status: 1 where
a bar is not met.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the matrices are small

import argparse
import hashlib
import json
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks.integrity.cases import PARTS, QUICK, Case, Size, cases
from benchmarks.integrity.diagram import diagram
from benchmarks.integrity.outcome import case_outcome
from benchmarks.integrity.page import PAGE, report, worst, written
from benchmarks.measured import FOLDER, ROOT, is_here, nothing_measured
from benchmarks.mount_accuracy.seeds import tuned_on

INTERRUPTED, USAGE = 130, 2
SHOWS_ONLY = ("__main__.py", "page.py", "diagram.py")
TOLD_EVERY_S = 30.0


def main() -> int:
    options = _options()
    size = QUICK if options.quick else Size()
    given = {k: getattr(options, k) for k in ("drives", "first", "hours", "logs")}
    size = replace(size, **{k: v for k, v in given.items() if v is not None})
    wanted = list(cases(size, tuple(options.only)))
    if tuned := tuned_on(sorted({int(case.base) for case in wanted if case.base.isdigit()})):
        print(f"--first {size.first}: seed {tuned[0]} was tuned on", file=sys.stderr)
        return USAGE
    if options.row:
        wanted = [case for case in wanted if case.row in options.row]
    if options.base:
        wanted = [case for case in wanted if case.base in options.base]
    path = options.results or FOLDER / f"integrity-{state()}.jsonl"
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        if not options.table:
            _run(wanted, path, options.jobs)
    except KeyboardInterrupt:
        print(f"\nbroken off; {path} is kept, the same command goes on", file=sys.stderr)
        return INTERRUPTED
    keys = {case.key for case in wanted}
    lines = [line for line in _read(path) if line["key"] in keys]
    text = report(lines)
    print(text)
    if options.worst:
        print(worst(lines, options.worst))
    if options.diagram is not None:
        options.diagram.write_text(diagram(lines), encoding="utf-8")
    logs = dict.fromkeys(case.base for case in wanted if not case.base.isdigit())
    if logs and not any(map(is_here, logs)):
        return nothing_measured(*logs)  # and nothing is written
    if options.write:
        PAGE.write_text(written(PAGE.read_text(encoding="utf-8"), text), encoding="utf-8")
    return 1 if "NOT MET" in text else 0


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), metavar="PART",
                        help="of " + ", ".join(PARTS))  # fmt: skip
    parser.add_argument("--row", nargs="+", help="only these faults, as the table names them")
    parser.add_argument("--base", nargs="+", help="only these seeds or logs")
    parser.add_argument("--drives", type=int, help="simulated drives a fault")
    parser.add_argument("--hours", type=int, help="of driving without a fault")
    parser.add_argument("--logs", type=int, help="how many of the measured logs")
    parser.add_argument("--first", type=int, help="first seed")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--quick", action="store_true", help="a few drives, in two minutes")
    parser.add_argument("--results", type=Path)
    parser.add_argument("--table", action="store_true", help="only tell what is there")
    parser.add_argument("--worst", type=int, help="name so many of the worst drives of each fault")
    parser.add_argument("--diagram", type=Path, help="SVG to write")
    parser.add_argument("--write", action="store_true", help=f"put the figures into {PAGE.name}")
    return parser.parse_args()


def state() -> str:
    """Names the code that the results come from."""
    digest = hashlib.sha256()
    here = ROOT / "benchmarks" / "integrity"
    files = sorted((ROOT / "daemon" / "imucald").rglob("*"))
    files += [path for path in sorted(here.glob("*.py")) if path.name not in SHOWS_ONLY]
    for path in files:
        if path.suffix in {".py", ".dbc", ".yaml"}:
            digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def _read(path: Path) -> list[dict[str, Any]]:
    """Outcomes so far, the last of each case; a line that was broken off is left out."""
    latest: dict[str, dict[str, Any]] = {}
    for text in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        if not text:
            continue
        try:
            line = json.loads(text)
        except json.JSONDecodeError:
            continue
        latest[line["key"]] = line
    return list(latest.values())


def _run(wanted: list[Case], path: Path, jobs: int) -> None:
    done = {line["key"] for line in _read(path)}
    left = [case for case in wanted if case.key not in done]
    began = told = time.monotonic()
    with path.open("a", encoding="utf-8") as file:
        file.write("\n")  # the last line may have been broken off
        for i, (case, line) in enumerate(_outcomes(left, jobs), start=1):
            if line is None:
                print(f"{case.base}: absent, not judged", file=sys.stderr)
                continue
            file.write(json.dumps(line) + "\n")
            file.flush()
            now = time.monotonic()
            if sys.stderr.isatty() or now - told > TOLD_EVERY_S:
                told = now
                rest = (now - began) / i * (len(left) - i) / 60.0
                _progress(f"{i} of {len(left)}, {rest:.0f} min left: {case.row}, {case.base}")


def _progress(text: str) -> None:
    if sys.stderr.isatty():
        print(f"\r{text:78s}", end="", file=sys.stderr, flush=True)
    else:
        print(text, file=sys.stderr, flush=True)


def _outcomes(left: list[Case], jobs: int) -> Iterator[tuple[Case, dict[str, Any] | None]]:
    if jobs <= 1:
        yield from map(case_outcome, left)
        return
    with get_context("spawn").Pool(jobs) as pool:
        yield from pool.imap(case_outcome, left, chunksize=8)


if __name__ == "__main__":
    sys.exit(main())
