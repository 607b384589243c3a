"""Cases are diagnosed, in one process or several; each outcome is one line of a file."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator, Sequence
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks.diagnosis.cases import Case
from benchmarks.diagnosis.measured_logs import STATE

REPORT_EVERY_S = 30.0


def known(path: Path) -> dict[str, dict[str, Any]]:
    """Outcomes of this state of the diagnosis, by case; a line that was broken off is left out."""
    found: dict[str, dict[str, Any]] = {}
    for text in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        try:
            line = json.loads(text)
        except json.JSONDecodeError:
            continue
        if line.get("state") == STATE:
            found[line["key"]] = line
    return found


def run(wanted: Sequence[Case], path: Path, jobs: int, seconds: float | None) -> None:
    """Diagnose what the file does not have, in the order given, for so long at most.

    Only this process writes, so that lines stay whole; SystemExit where another one does.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    done = known(path)
    left = [case for case in wanted if case.key not in done]
    began = reported = time.monotonic()
    with path.open("a", encoding="utf-8") as file:
        _own(file, path)
        file.write("\n")  # the last line may have been broken off
        for i, line in enumerate(_outcomes(left, jobs), start=1):
            file.write(json.dumps(line, ensure_ascii=False, default=float) + "\n")
            file.flush()
            now = time.monotonic()
            if sys.stderr.isatty() or now - reported > REPORT_EVERY_S or i == len(left):
                reported = now
                rest = (now - began) / i * (len(left) - i) / 60.0
                _progress(f"{i} of {len(left)}, {rest:.0f} min left: {line['key']}")
            if seconds is not None and now - began > seconds:
                return


def _own(file: Any, path: Path) -> None:
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        raise SystemExit(f"{path}: another run writes to it; give --results, or --jobs") from None


def _progress(text: str) -> None:
    if sys.stderr.isatty():
        print(f"\r{text:78s}", end="", file=sys.stderr, flush=True)
    else:
        print(text, file=sys.stderr, flush=True)


def _outcomes(left: Sequence[Case], jobs: int) -> Iterator[dict[str, Any]]:
    if jobs <= 1:
        yield from map(one, left)
        return
    with get_context("spawn").Pool(jobs) as pool:
        yield from pool.imap_unordered(one, left)


def one(case: Case) -> dict[str, Any]:
    """Outcome of a case; an exception is one too, and counts as wrong."""
    from benchmarks.diagnosis.outcome import line_of, outcome

    try:
        return outcome(case)
    except Exception as error:
        why = f"{type(error).__name__}: {error}"
        return {**line_of(case, ("no exception",)), "verdict": "crash", "crash": why}
