"""From which size on an effect outside the catalogue is seen: seen and wrong names by size.

    python -m benchmarks.diagnosis.power [--draws 0 1] [--effects NAME ...] [--logs LOG ...]

A factor is on the size that `outcome.of_medium_size` gives. Effects that were not run before the
judge are left out.
"""

from __future__ import annotations

import argparse
import sys

from benchmarks.diagnosis.cases import Case
from benchmarks.diagnosis.judged import wrong_names
from benchmarks.diagnosis.measured_logs import LOGS, read_log
from benchmarks.diagnosis.outcome import (
    of_medium_size,
    piece_model,
    rng_of,
    values_of,
    zero_at_rest,
)
from benchmarks.diagnosis.outside_effects import NOT_RUN, OUTSIDE
from imucald.diagnosis.cause_keys import mount_of
from imucald.diagnosis.diagnose import diagnose

FACTORS = (0.25, 0.5, 1.0, 2.0)


def main() -> int:
    known = [name for name in OUTSIDE if name not in NOT_RUN]
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--draws", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--effects", nargs="+", choices=known, default=known)
    parser.add_argument("--logs", nargs="+", choices=LOGS, default=list(LOGS[:3]))
    options = parser.parse_args()
    print("| effect |", " | ".join(f"x {x:g}" for x in FACTORS), "| wrong names |")
    print("|", " | ".join(["---"] * (len(FACTORS) + 2)), "|")
    for effect in options.effects:
        seen, asked, wrong = dict.fromkeys(FACTORS, 0), 0, 0
        for draw in options.draws:
            for log in options.logs:
                case = Case("outside", log, effect, 1, draw, 2, draw % 2)
                made = of_medium_size(case)
                if made is None or made[2].ratio < 1.0:
                    continue
                asked += 1
                for factor in FACTORS:
                    is_seen, is_wrong = _one(case, factor * made[1])
                    seen[factor] += is_seen
                    wrong += is_wrong
        cells = " | ".join(f"{n} of {asked}" for n in seen.values())
        print(f"| {effect} | {cells} | {wrong} of {asked * len(FACTORS)} |", flush=True)
    return 0


def _one(case: Case, size: float) -> tuple[bool, bool]:
    """Whether an effect of this size is seen, and whether a wrong name is given."""
    model, put = piece_model(case), OUTSIDE[case.effect][0]
    changed = dict(read_log(case.log).pieces(case.pieces)[case.piece])
    put(changed, size, rng_of(case), mount_of(model))
    d = diagnose([changed], model)
    line = {"log": case.log, "right": ["unknown"], "said": [c.name for c in d.causes],
            "sets": d.look_alikes, "values": values_of(d),
            "at_rest": zero_at_rest(changed, model)}  # fmt: skip
    return d.verdict == "unknown" or bool(d.structure), bool(wrong_names(line))


if __name__ == "__main__":
    sys.exit(main())
