"""Does the estimator work with signals as real buses carry them?

    python -m benchmarks.signal_forms [--form TEXT ...] [--drives N] [--first SEED] [--jobs N]
                                      [--group simulated second_world measured] [--check]
                                      [--json FILE] [--table FILE ...] [--causes]

Each form (`forms`) is put on sound drives: ten simulated ones that nothing was chosen on, each as
drivers drive and with constant cruising, with the sensor in any rotation; another simulator's
drives; measured logs. The spoilt signals are written as a log with a database of their own, and
replayed as `imucald replay` does; the same drive unspoilt is its twin. Bars: usable in 95 % of the
runs within 1.5 times the twin's time, never suspect, never moved, never recalibrating, intervals
hold, at most 5 % of the driving not learnt from, and that named. A form that cannot carry the
information: `check` says so. Exit status: 1 where a bar is not met.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the matrices are small

import argparse
import json
import sys
import time
from collections.abc import Iterator
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks.measured import DATA, is_here, nothing_measured
from benchmarks.mount_accuracy.seeds import tuned_on
from benchmarks.signal_forms.drives import DRIVES, FIRST_SEED, Put, drives
from benchmarks.signal_forms.forms import FORMS
from benchmarks.signal_forms.outcome import outcomes
from benchmarks.signal_forms.report import report, row

GROUPS = ("simulated", "second_world", "measured")
USAGE = 2

Job = tuple[Put, tuple[str, ...], bool]


def main() -> int:
    options = _options()
    if tuned := tuned_on(range(options.first, options.first + options.drives)):
        print(f"--first {options.first}: seed {tuned[0]} was tuned on", file=sys.stderr)
        return USAGE
    wanted = [f.name for f in FORMS if not options.form or any(x in f.name for x in options.form)]
    if options.table:
        lines = [one for path in options.table for one in json.loads(path.read_text("utf-8"))]
        lines = [line for line in lines if line["form"] in wanted]
    else:
        lines = _run(options, tuple(wanted))
    if options.json is not None:
        options.json.write_text(json.dumps(lines), "utf-8")
    if not lines and "simulated" not in options.group:
        return nothing_measured(*(put.name for put in drives(0, 0, tuple(options.group))))
    text, is_met = report(lines)
    print(text)
    if options.causes:
        print(causes(lines))
    return 0 if is_met else 1


def _run(options: argparse.Namespace, wanted: tuple[str, ...]) -> list[dict[str, Any]]:
    puts = drives(options.drives, options.first, tuple(options.group))
    absent = [p.name for p in puts if p.group != "simulated" and not is_here(p.name)]
    if absent:
        print(f"absent from {DATA}, not judged: {', '.join(absent)}")
    puts = [put for put in puts if put.name not in absent]
    began, lines = time.monotonic(), []
    jobs = [(put, wanted, options.check) for put in puts]
    for done, found in enumerate(_outcomes(jobs, options.jobs), start=1):
        lines += found
        spent = (time.monotonic() - began) / 60.0
        print(f"{done} of {len(jobs)} drives, {spent:.1f} min", file=sys.stderr, flush=True)
        if options.json is not None:
            options.json.write_text(json.dumps(lines), "utf-8")
    return lines


def _outcomes(jobs: list[Job], processes: int) -> Iterator[list[dict[str, Any]]]:
    if processes <= 1:
        yield from map(outcomes, jobs)
        return
    with get_context("spawn").Pool(processes) as pool:
        yield from pool.imap_unordered(outcomes, jobs)


def causes(lines: list[dict[str, Any]]) -> str:
    """Of each form that fails, what its runs say of themselves."""
    out = []
    for form in FORMS:
        mine = [line for line in lines if line["form"] == form.name]
        if not mine or not row(form, mine)[1]:
            continue
        out.append(f"\n{form.name}")
        for line in mine:
            told = {
                key: line[key]
                for key in (
                    "refused", "usable_s", "twin_usable_s", "bad", "moves", "faults", "why",
                    "frozen_ticks", "not_learnt_from", "health", "rejected", "waiting_for",
                )
                if line.get(key)
            }  # fmt: skip
            out.append(f"  {line['drive']}: {json.dumps(told)}")
            out += [f"    check: {text}" for text in line.get("check", {}).get("texts", [])]
    return "\n".join(out)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--form", nargs="+", help="only forms whose name contains one of these")
    parser.add_argument("--drives", type=int, default=DRIVES, help="simulated drives")
    parser.add_argument("--first", type=int, default=FIRST_SEED, help="first seed")
    parser.add_argument("--group", nargs="+", choices=GROUPS, default=list(GROUPS))
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--check", action="store_true", help="ask `check` of every form, not only "
                        "of those that cannot carry the information")  # fmt: skip
    parser.add_argument("--json", type=Path, help="keep every run's figures here")
    parser.add_argument("--table", type=Path, nargs="+", help="only tell what such files hold")
    parser.add_argument(
        "--causes", action="store_true", help="what each failing run says of itself"
    )
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
