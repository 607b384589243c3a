"""Hidden effects, found or not: the figures of docs/diagnosis-accuracy.md.

    python -m benchmarks.diagnosis [--only PART ...] [--drives N] [--first SEED] [--jobs N]
                                   [--results FILE] [--cause NAME ...] [--no-gain]
                                   [--table] [--write]

Parts: naming (each of 26 causes), nulls, pairs, outside (effects that the catalogue lacks). Each
drive's outcome is kept as one line of JSON in the results file; a run that was broken off goes on
where it stopped, and several runs may share a file. --drives: per cause in naming and outside, in
all in the others. --write puts the tables into the page.
"""

from __future__ import annotations

import argparse
import json
import sys
import traceback
from collections.abc import Iterator
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks.diagnosis.cases import FIRST_SEED, PARTS, Case, cases
from benchmarks.diagnosis.page import PAGE, report, written
from benchmarks.measured import FOLDER

RESULTS = FOLDER / "diagnosis.jsonl"


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), metavar="PART")
    parser.add_argument("--cause", nargs="+", help="only drives in which one of these is hidden")
    parser.add_argument("--drives", type=int)
    parser.add_argument("--first", type=int, default=FIRST_SEED)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--no-gain", action="store_true", help="without the daemon's runs")
    parser.add_argument(
        "--table", action="store_true", help="only make the tables of what is there"
    )
    parser.add_argument("--write", action="store_true", help=f"put the tables into {PAGE.name}")
    options = parser.parse_args()
    wanted = [case for part in options.only for case in cases(part, options.drives, options.first)]
    if options.cause:
        wanted = [c for c in wanted if any(e.cause in options.cause for e in c.effects)]
    if options.no_gain:
        wanted = [replace(c, with_gain=False) for c in wanted]
    options.results.parent.mkdir(parents=True, exist_ok=True)
    if not options.table:
        _run(wanted, options.results, options.jobs)
    keys = {case.key for case in wanted}
    lines = [line for line in _read(options.results) if line["key"] in keys]
    text = report(lines)
    print(text)
    if options.write:
        PAGE.write_text(written(PAGE.read_text(encoding="utf-8"), text), encoding="utf-8")
    return 0


def _read(path: Path) -> list[dict[str, Any]]:
    """Outcomes so far, the last of each case."""
    if not path.exists():
        return []
    lines = path.read_text(encoding="utf-8").splitlines()
    latest = {line["key"]: line for line in map(json.loads, filter(None, lines))}
    return list(latest.values())


def _run(wanted: list[Case], path: Path, jobs: int) -> None:
    done = {line["key"] for line in _read(path) if "error" not in line}
    left = [case for case in wanted if case.key not in done]
    with path.open("a", encoding="utf-8") as file:
        for i, line in enumerate(_outcomes(left, jobs)):
            file.write(json.dumps(line) + "\n")
            file.flush()
            said = "+".join(c["name"] for c in line["said"]["causes"])
            progress = f"{i + 1} of {len(left)}  {line['key']}: {line['said']['verdict']} {said}"
            print(f"{progress}  {line['cpu_s']:.0f} s", file=sys.stderr, flush=True)


def _outcomes(left: list[Case], jobs: int) -> Iterator[dict[str, Any]]:
    if jobs <= 1:
        yield from map(_one, left)
        return
    with get_context("spawn").Pool(jobs, maxtasksperchild=20) as pool:
        yield from pool.imap_unordered(_one, left)


def _one(case: Case) -> dict[str, Any]:
    """An outcome; a diagnosis that breaks is one, too."""
    from benchmarks.diagnosis.outcome import outcome

    try:
        return outcome(case)
    except Exception:
        return {
            "key": case.key,
            "part": case.part,
            "seed": case.seed,
            "minutes": case.minutes,
            "hidden": [[e.cause, e.size] for e in case.effects],
            "cpu_s": 0.0,
            "said": {"verdict": "error", "causes": [], "look_alikes": [], "signals": {}},
            "error": traceback.format_exc(),
            "scores": [],
        }


if __name__ == "__main__":
    sys.exit(main())
