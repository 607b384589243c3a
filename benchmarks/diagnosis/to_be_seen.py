"""Table of what is there to be seen (`ideal`) of each effect outside the catalogue, on each log.

python -m benchmarks.diagnosis.to_be_seen
"""

from __future__ import annotations

import argparse
import sys

from benchmarks.diagnosis.cases import cases
from benchmarks.diagnosis.outcome import of_medium_size
from benchmarks.diagnosis.outside_effects import OUTSIDE


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--effects", nargs="+", choices=list(OUTSIDE), default=list(OUTSIDE))
    parser.add_argument("--draw", type=int, default=0)
    options = parser.parse_args()
    print("| log | effect | size | shows in | ideal [sd] | needed [sd] |")
    print("| --- | --- | --- | --- | --- | --- |")
    for case in cases("outside", range(options.draw, options.draw + 1)):
        made = of_medium_size(case) if case.effect in options.effects else None
        if made is not None:
            _, size, seen = made
            print(f"| {case.log} | {case.effect} | {size:.3g} | {seen.equation} | {seen.ideal:.1f} "
                  f"| {seen.needed:.1f} |", flush=True)  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
