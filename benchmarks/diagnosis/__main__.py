"""Does the diagnosis name what is hidden, and nothing else? The figures of the page.

    python -m benchmarks.diagnosis [--only PART ...] [--first-draw N] [--draws N] [--jobs N]
                                   [--seconds S] [--results FILE] [--table] [--write]

Outcomes are kept in a file and not made again while the diagnosis is the same: a run that is
stopped goes on where it was. Cases come draw by draw, the parts in an even mix, so that a run that
--seconds ends is fair; what was not reached is said. Exit status: 1 where a bar is not met.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the matrices are small

import argparse
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.diagnosis import judged
from benchmarks.diagnosis.bars import bars
from benchmarks.diagnosis.cases import FIRST_SEED, OF_LOGS, PARTS, Case, cases
from benchmarks.diagnosis.measured_logs import LOGS
from benchmarks.diagnosis.run import known, run
from benchmarks.measured import FOLDER, ROOT, nothing_measured

PAGE = ROOT / "benchmarks" / "records" / "diagnosis-accuracy.md"
RESULTS = FOLDER / "diagnosis.jsonl"
BEGIN, END = "<!-- figures -->", "<!-- end of figures -->"


INTERRUPTED = 130


def main() -> int:
    options = _options()
    draws = range(options.first_draw, options.first_draw + options.draws)
    asked = {
        part: list(_chosen(cases(part, draws, options.first_seed), options))
        for part in options.only
    }
    of_logs = [part for part in options.only if part in OF_LOGS]
    has_no_logs = bool(of_logs) and not any(asked[part] for part in of_logs)
    if has_no_logs and not any(asked.values()):
        return nothing_measured(*LOGS, "second_world")
    try:
        if not options.table:
            run(mixed(asked), options.results, options.jobs, options.seconds)
    except KeyboardInterrupt:
        print(f"\nbroken off; {options.results} is kept, the same command goes on", file=sys.stderr)
        return INTERRUPTED
    outcomes = known(options.results)
    by_part = {
        part: [outcomes[c.key] for c in asked.get(part, ()) if c.key in outcomes] for part in PARTS
    }
    missed = {part: sum(c.key not in outcomes for c in own) for part, own in asked.items()}
    text = "\n".join(_report(by_part, missed))
    print(text)
    if has_no_logs:
        return nothing_measured(*LOGS, "second_world")  # and nothing is written
    if options.write:
        page = PAGE.read_text(encoding="utf-8")
        head, rest = page.split(BEGIN)
        PAGE.write_text(f"{head}{BEGIN}\n{text}\n{END}{rest.split(END)[1]}", encoding="utf-8")
    return 1 if "NOT MET" in text else 0


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), metavar="PART",
                        help="of " + ", ".join(PARTS))  # fmt: skip
    parser.add_argument("--draws", type=int, default=1, help="how many")
    parser.add_argument("--first-draw", type=int, default=0, help="draws before it are not made")
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED, help="of the generator")
    parser.add_argument("--levels", type=int, nargs="+", help="sizes (0 to 3); default: all")
    parser.add_argument("--effects", nargs="+", help="default: all")
    parser.add_argument("--logs", nargs="+", help="measured logs; default: all")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--seconds", type=float, help="end the run after so long")
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--table", action="store_true", help="only tell what is there")
    parser.add_argument("--write", action="store_true", help=f"put the figures into {PAGE.name}")
    return parser.parse_args()


def mixed(asked: Mapping[str, Sequence[Case]]) -> list[Case]:
    """Draw by draw; within one, the same share of every part is done at any time."""
    placed = []
    for order, own in enumerate(asked.values()):
        of_draw: dict[int, list[Case]] = {}
        for case in own:
            of_draw.setdefault(case.draw, []).append(case)
        for draw, some in of_draw.items():
            placed += [(draw, (i + 0.5) / len(some), order, c) for i, c in enumerate(some)]
    return [case for *_, case in sorted(placed, key=lambda x: x[:3])]


def _chosen(some: Iterable[Case], options: argparse.Namespace) -> Iterator[Case]:
    """Those of the sizes, effects and logs that were asked for."""
    for case in some:
        is_asked = (
            (options.levels is None or case.level in options.levels)
            and (options.effects is None or case.effect in options.effects)
            and (options.logs is None or case.log in options.logs)
        )
        if is_asked or case.part in ("nulls", "plain_nulls"):
            yield case


def _report(
    by_part: Mapping[str, Sequence[Mapping[str, Any]]], missed: Mapping[str, int]
) -> Iterator[str]:
    yield "### Bars"
    yield ""
    yield from bars(by_part)
    yield ""
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
    yield "### Measured logs without a model file"
    yield ""
    yield from judged.plain(by_part["plain"], by_part["plain_nulls"])
    yield ""
    yield "### In sum"
    yield ""
    for part, own in by_part.items():
        rest = f" ({missed[part]} cases were not reached)" if missed.get(part) else ""
        yield f"- {judged.summary(part, own)}{rest}."
    yield ""
    yield from judged.calibration([x for own in by_part.values() for x in judged.asked_of(own)])


if __name__ == "__main__":
    sys.exit(main())
