"""Whether effects that take information away turn the daemon's mount, or only make it less sure.

    python -m benchmarks.diagnosis.turns [--drives N] [--first SEED] [--cause NAME ...]

Rough roads, lost and stuck signals and a shift push the mount to no side by themselves. Each drive
goes through the daemon with the effect and without, both with the honest model file. Over drives of
medium and large size: the mean of the turns about each axis with its standard error, and the rms
turn beside what the estimator states: a less certain estimate may differ from a more certain one by
the root of the difference of their variances.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np
from numpy.typing import NDArray

from benchmarks.diagnosis.judged import turn
from benchmarks.diagnosis.outcome import daemon
from hidden import Effect, hidden_drive

Array = NDArray[np.float64]

CAUSES = ("mount_shift", "road_grade", "road_bank", "dropouts", "stuck_signal", "clock_drift")
FIRST_SEED = 950_000
MINUTES = 22.0
CAUSE_SEEDS = 1000
"""Seeds of different causes lie this far apart."""


def turns(cause: str, first: int, drives: int) -> tuple[Array, Array]:
    """Turns (N, 3) [deg] by an effect, and what both estimates' variances differ by (N, 3)."""
    found, more = [], []
    for k in range(drives):
        effect = Effect(cause, ("medium", "large")[k % 2])
        vehicle = {}
        for name, effects in (("without", ()), ("before", (effect,))):
            made = hidden_drive(first + k, effects, MINUTES)
            vehicle[name] = daemon(made, made.model)
        by = turn({"vehicle": vehicle}, "before")
        if by is None:
            continue
        having, without = (np.square(vehicle[name]["std_deg"]) for name in ("before", "without"))
        found.append(by)
        more.append(having - without)
        print(f"\r{cause}: {k + 1} of {drives}   ", end="", file=sys.stderr, flush=True)
    return np.array(found), np.array(more)


def line(cause: str, found: Array, more: Array) -> str:
    """One row of the table."""
    n = len(found)
    mean, spread = found.mean(axis=0), found.std(axis=0, ddof=1) / np.sqrt(n)
    rms = np.sqrt((found**2).mean(axis=0))
    stated = np.sqrt(np.maximum(more.mean(axis=0), 0.0))
    cells = [f"{m:+.3f} ± {s:.3f}" for m, s in zip(mean, spread, strict=True)]
    cells += [f"{a:.3f} ({b:.3f})" for a, b in zip(rms, stated, strict=True)]
    return f"| {cause} | {n} | {' | '.join(cells)} |"


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--drives", type=int, default=16)
    parser.add_argument("--first", type=int, default=FIRST_SEED)
    parser.add_argument("--cause", nargs="+", choices=CAUSES, default=list(CAUSES))
    options = parser.parse_args()
    print("| effect | drives | mean turn [deg], roll | pitch | yaw", end="")
    print(" | rms (allowed), roll | pitch | yaw |")
    print("|---|---|---|---|---|---|---|---|")
    for cause in options.cause:
        first = options.first + CAUSE_SEEDS * CAUSES.index(cause)
        print("\r" + line(cause, *turns(cause, first, options.drives)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
