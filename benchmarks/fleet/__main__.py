"""Figures of `imucald fleet` beside its bars.

    python -m benchmarks.fleet [--only PART] [--fleets 60] [--copies 5]

Statistics and throughput are measured apart. *Statistics*: rows of simulated fleets with errors as
records/mount-accuracy.md has them, no logs (200 vehicles of 5 types, 5 drives each, 4 % of pairs of
drives with a remount of 2 deg between, 1 bad batch of 10, 3 outliers of 2 deg); seeds from 50000,
while what was chosen was chosen on seeds from 1000. *Throughput*: simulated logs of 10 min through
the command line, two poison logs among them. *Scale*: 100,000 rows
through driver and analysis. *End to end*: a small fleet of simulated logs with known mounts.
"""

from __future__ import annotations

import argparse
import sys
import tempfile

import numpy as np

from benchmarks.fleet.end_to_end import DRIVES, MINUTES, MOVED, ODD, VEHICLES, end_to_end
from benchmarks.fleet.simulated_fleet import Design
from benchmarks.fleet.statistics import AXES, Scores, run
from benchmarks.fleet.throughput import throughput
from benchmarks.measured import run as run_process

SEED = 50_000
LOWEST, HIGHEST = 0.90, 0.98
PARTS = ("statistics", "throughput", "scale", "end_to_end")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=PARTS)
    parser.add_argument("--fleets", type=int, default=60)
    parser.add_argument("--copies", type=int, default=5)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    if options.only in (None, "statistics"):
        _statistics(options.fleets)
    if options.only in (None, "throughput"):
        _throughput(options.copies, options.rounds)
    if options.only in (None, "scale"):
        _scale()
    if options.only in (None, "end_to_end"):
        _end_to_end()
    return 0


def _met(good: bool) -> str:
    return "met" if good else "NOT MET"


def _statistics(fleets: int) -> None:
    print(f"{fleets} fleets of 200 vehicles x 5 drives, seeds from {SEED}")
    scores = run(fleets, Design(), SEED)
    for name, rows in scores.covered.items():
        held = np.mean(rows, axis=0)
        # all vehicles of a fleet share one crown: roll is a figure of so many fleets, no more
        text = ", ".join(f"{a} {100 * h:.1f}" for a, h in zip(AXES, held, strict=True))
        good = bool(((held >= LOWEST) & (held <= HIGHEST)).all())
        print(f"95 % intervals of {name} hold {text} % of {len(rows)} (bar 90-98: {_met(good)})")
    for name in ("remounts", "outliers", "batches"):
        false, power = np.mean(scores.false_share[name]), np.mean(scores.power[name])
        good = _met(bool(false <= 0.10)), _met(bool(power >= 0.90))
        print(
            f"{name}: false discoveries {100 * false:.1f} % (bar 10: {good[0]}), "
            f"power {100 * power:.1f} % of {len(scores.power[name])} (bar 90: {good[1]})"
        )
    _errors("5 drives", scores)
    for drives in (1, 2):
        plain = Design(drives=drives, remount_share=0.0)
        _errors(
            f"{drives} drive{'s' * (drives > 1)}, no remounts",
            run(max(fleets // 4, 5), plain, SEED),
        )
    for size in (1.0, 1.5, 2.0, 3.0, 5.0):
        scores = run(max(fleets // 6, 5), Design(remount_deg=size, outlier_deg=size), SEED + 1000)
        for name in ("remounts", "outliers"):
            power, false = 100 * np.mean(scores.power[name]), np.mean(scores.false_share[name])
            print(f"{name} of {size} deg: found {power:.0f} %, false {100 * false:.0f} %")


def _errors(title: str, scores: Scores) -> None:
    """Errors of vehicles' mounts now; beyond the crown, which no statistics can take out."""
    print(
        f"errors of mounts, {title} (rms x, y, z; median and 90th percentile of the angle) [deg]:"
    )
    for name, rows in scores.error.items():
        e = np.array(rows)
        rms = ", ".join(f"{v:.2f}" for v in np.sqrt((e**2).mean(axis=0)))
        angle = np.linalg.norm(e, axis=1)
        print(f"  {name:<26} {rms}; {np.median(angle):.2f}, {np.quantile(angle, 0.9):.2f}")


def _throughput(copies: int, rounds: int) -> None:
    t = throughput(copies, rounds)
    print(f"{t.logs} logs of 10 min (2 of them poison), {t.megabytes:.0f} MB")
    print("  wall and processor time [s]: plain replay; 1 worker; 2 workers; times; load before")
    for r in t.rounds:
        times = "; ".join(f"{one.wall:6.1f} {one.cpu:6.1f}" for one in (r.plain, r.one, r.two))
        print(f"  {times}; {r.speedup:.2f}; {r.load[0]:.1f}, {r.load[1]:.1f}")
    print(
        f"two workers against one: {t.speedup:.2f} times, median of {len(t.rounds)} "
        f"(bar 1.8: {_met(t.speedup >= 1.8)})"
    )
    most = max(t.overhead_cpu_s, t.overhead_wall_s)
    print(
        f"a log beside its replay: {t.overhead_cpu_s:.3f} s of processor, "
        f"{t.overhead_wall_s:.3f} s by the clock with one worker (bar 0.5: {_met(most <= 0.5)})"
    )


def _scale() -> None:
    for vehicles, drives in ((20_000, 5), (200, 500)):
        print(f"{vehicles} vehicles x {drives} drives:")
        with tempfile.TemporaryDirectory() as folder:
            module = [sys.executable, "-m", "benchmarks.fleet.scale", folder]
            for arguments in ([str(vehicles), str(drives)], []):
                for line in run_process([*module, *arguments]).output.splitlines():
                    print(f"  {line}")
    print("bars: memory of the driver 500 MiB, analyse 60 s")


def _end_to_end() -> None:
    found = end_to_end()
    print(f"{VEHICLES} vehicles x {DRIVES} simulated logs of {MINUTES} min, {found.drives} known")
    moved = [f"car-{v:02}/{d}.log" for v, d in MOVED.items()]
    print(f"  sensors moved by 3 deg before {', '.join(moved)}; found: {', '.join(found.remounts)}")
    print(f"  3 deg beside its type: car-{ODD:02}; found: {', '.join(found.outliers)}")
    for name, held in found.held.items():
        share = ", ".join(
            f"{a} {100 * h:.0f}" for a, h in zip(AXES, np.mean(held, axis=0), strict=True)
        )
        error = np.array(found.error[name])
        print(
            f"  {name}: 95 % intervals hold {share} %; error median {np.median(error):.2f}, "
            f"90th percentile {np.quantile(error, 0.9):.2f} deg"
        )


if __name__ == "__main__":
    sys.exit(main())
