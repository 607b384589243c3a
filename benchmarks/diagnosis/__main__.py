"""Does the diagnosis name what is hidden, and nothing else?

    python -m benchmarks.diagnosis [--only PART ...] [--draws N] [--seconds S] [--write]

Outcomes are kept in a file and not made again while the diagnosis is the same: a run that is
stopped goes on where it was.
--seconds ends a part's run after so much processor time; what was not reached is said.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from benchmarks.diagnosis import judged
from benchmarks.diagnosis.cases import FIRST_SEED, OF_LOGS, PARTS, Case, cases
from benchmarks.diagnosis.measured_logs import LOGS, STATE
from benchmarks.measured import FOLDER, ROOT, nothing_measured

PAGE = ROOT / "docs" / "diagnosis-accuracy.md"
RESULTS = FOLDER / "diagnosis.jsonl"
BEGIN, END = "<!-- figures -->", "<!-- end of figures -->"


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), metavar="PART")
    parser.add_argument("--draws", type=int, default=1)
    parser.add_argument("--first-draw", type=int, default=0, help="draws before it are not made")
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED, help="of the generator")
    parser.add_argument("--levels", type=int, nargs="+", help="sizes (0 to 3); default: all")
    parser.add_argument("--effects", nargs="+", help="default: all")
    parser.add_argument("--logs", nargs="+", help="measured logs; default: all")
    parser.add_argument("--seconds", type=float, default=3600.0)
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    options.results.parent.mkdir(parents=True, exist_ok=True)
    known = _known(options.results)
    draws = range(options.first_draw, options.first_draw + options.draws)
    asked = {p: list(_chosen(cases(p, draws, options.first_seed), options)) for p in PARTS}
    of_logs = [part for part in options.only if part in OF_LOGS]
    has_no_logs = bool(of_logs) and not any(asked[part] for part in of_logs)
    if has_no_logs and not any(asked[part] for part in options.only):
        return nothing_measured(*LOGS, "second_world")
    missed = {}
    with options.results.open("a", encoding="utf-8") as file:
        for part in options.only:
            wanted = asked[part]
            until = time.process_time() + options.seconds
            for case in wanted:
                if case.key in known or time.process_time() > until:
                    continue
                known[case.key] = _one(case, file)
            missed[part] = sum(case.key not in known for case in wanted)
    lines = [known[c.key] for p in PARTS for c in asked[p] if c.key in known]
    text = "\n".join(_report(lines, missed))
    print(text)
    if has_no_logs:
        return nothing_measured(*LOGS, "second_world")  # and nothing is written
    if options.write:
        page = PAGE.read_text(encoding="utf-8")
        head, rest = page.split(BEGIN)
        PAGE.write_text(f"{head}{BEGIN}\n{text}\n{END}{rest.split(END)[1]}", encoding="utf-8")
    return 0


def _chosen(some: Iterable[Case], options: argparse.Namespace) -> Iterator[Case]:
    """Those of the sizes, effects and logs that were asked for."""
    for case in some:
        is_asked = (
            (options.levels is None or case.level in options.levels)
            and (options.effects is None or case.effect in options.effects)
            and (options.logs is None or case.log in options.logs)
        )
        if is_asked or case.part == "nulls":
            yield case


def _known(path: Path) -> dict[str, Any]:
    if not path.exists():
        return {}
    lines = map(json.loads, path.read_text(encoding="utf-8").splitlines())
    return {line["key"]: line for line in lines if line.get("state") == STATE}


def _one(case: Case, file: Any) -> dict[str, Any]:
    from benchmarks.diagnosis.outcome import as_line, outcome

    result = outcome(case)
    file.write(as_line(result) + "\n")
    file.flush()
    said = result.get("refused") or f"{result['verdict']} {result['said']} {result['sets']}"
    print(case.key, said, file=sys.stderr, flush=True)
    return result


def _report(lines: list[dict[str, Any]], missed: dict[str, int]) -> Iterator[str]:
    by_part = {part: [x for x in lines if x["part"] == part] for part in PARTS}
    yield "### Hidden in measured logs"
    yield ""
    yield from judged.hidden(by_part["measured"], by_part["nulls"])
    yield ""
    yield "### Measured logs as they are"
    yield ""
    yield from judged.nulls(by_part["nulls"])
    yield ""
    yield "### Effects outside the catalogue, in measured logs"
    yield ""
    yield from judged.outside(by_part["outside"], by_part["nulls"])
    yield ""
    yield from judged.drives([x for x in by_part["outside"] if "refused" not in x], "Of all pieces")
    yield ""
    yield "### Drives of an independent simulator (`second_world`)"
    yield ""
    yield from judged.drives(by_part["second_world"], "Drives")
    yield ""
    yield "### Drives of the project's second generator"
    yield ""
    for part, what in (
        ("generated", "With a cause hidden"),
        ("generated_nulls", "As the model file says"),
        ("generated_outside", "With an effect outside the catalogue"),
    ):
        yield from judged.drives(by_part[part], what)
        yield ""
    yield "### In sum"
    yield ""
    for part, own in by_part.items():
        rest = f" ({missed[part]} cases were not reached)" if missed.get(part) else ""
        yield f"- {judged.summary(part, own)}{rest}."
    yield f"- {judged.file_alone(lines)}"
    yield f"- {judged.cost(lines)}"
    yield ""
    yield from judged.calibration(lines)


if __name__ == "__main__":
    sys.exit(main())
