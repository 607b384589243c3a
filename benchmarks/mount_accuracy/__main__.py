"""Mount accuracy on simulated drives: the figures of benchmarks/records/mount-accuracy.md.

    python -m benchmarks.mount_accuracy [--quick] [--first SEED] [--only PART ...] [--drives N]
                                        [--write]

Every drive has crown and grade (2 % rms), squat and body roll, accelerometer bias 10 mg, gyro
bias 0.3 deg/s, speed scale 1 %, vibration, time jitter, delays of 0-0.3 s and any mount, with or
without standing first (`imucald.simulation.random_model`). The seeds are not those that the
estimator was tuned on. --quick: a few short drives, to see that it runs.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the matrices are small

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.measured import ROOT, verdict
from benchmarks.mount_accuracy.bound import error_and_bound
from benchmarks.mount_accuracy.drives import (
    FULL,
    Trace,
    drive,
    driven,
    estimators,
    run,
    usual_estimator,
)
from benchmarks.mount_accuracy.seeds import (
    BOUND_AT,
    FIRST_SEED,
    LONG_AT,
    QUIET_AT,
    SHIFTS_APART,
    SHIFTS_AT,
    tuned_on,
)
from benchmarks.mount_accuracy.tables import bars, force_table, quantiles, table
from imucald.motion import ticks as tk
from imucald.mount.estimator import JointEstimator

PAGE = ROOT / "benchmarks" / "records" / "mount-accuracy.md"
TIMES = (2.0, 5.0, 10.0, 40.0)
SHIFTS = (
    ("yaw", 1.0, 300.0, 0.90),
    ("yaw", 2.0, 180.0, 0.99),
    ("yaw", 5.0, 120.0, 1.00),
    ("pitch", 2.0, 300.0, 0.90),
    ("pitch", 5.0, 120.0, 1.00),
    ("roll", 2.0, 300.0, 0.90),
    ("roll", 5.0, 120.0, 1.00),
)
"""Angle, size [deg], to be found within [s] of driving, in that share of drives."""


@dataclass(frozen=True)
class Size:
    """How much is simulated."""

    drives: int = 240
    bound_drives: int = 400
    long_drives: int = 40
    long_minutes: float = 240.0
    shift_drives: int = 100
    quiet_drives: int = 300
    quiet_minutes: float = 60.0
    times: tuple[float, ...] = TIMES
    first: int = FIRST_SEED

    def seeds(self) -> set[int]:
        """Seeds of all parts."""
        parts = [
            (0, self.drives),
            (SHIFTS_AT, SHIFTS_APART * (len(SHIFTS) - 1) + self.shift_drives),
            (BOUND_AT, self.bound_drives),
            (LONG_AT, self.long_drives),
            (QUIET_AT, self.quiet_drives),
        ]
        return {seed for at, n in parts for seed in range(self.first + at, self.first + at + n)}


QUICK = Size(2, 2, 1, 12.0, 1, 1, 10.0, (2.0, 5.0))


def traces(size: Size, cross_axis: float, has_gyro: bool = True) -> dict[str, list[Trace]]:
    """Both estimators over the same drives."""
    out: dict[str, list[Trace]] = {name: [] for name in estimators()}
    for seed in range(size.first, size.first + size.drives):
        made = drive(seed, max(size.times), cross_axis=cross_axis)
        if not has_gyro:
            made.rows[:, tk.GYRO.n] = 0.0
            made.rows[:, tk.GYRO.x : tk.GYRO.age + 1] = np.nan
        for name, estimator in estimators(cross_axis if has_gyro else 0.0).items():
            out[name].append(run(estimator, made, size.times))
        progress(f"drive {seed - size.first + 1} of {size.drives}")
    return out


def accuracy(size: Size) -> list[str]:
    """Errors, coverage, evidence, time to usable and cost."""
    lines: list[str] = []
    for title, cross in (("", 0.0), (", 0.5 % accelerometer cross-axis error", 0.005)):
        found = traces(size, cross)
        lines += ["", f"### Errors on {size.drives} mixed drives{title}", ""]
        lines += table(found, size.times)
        lines += ["", "What a consumer gets: cross-talk [deg] and level zero [m/s²]:", ""]
        lines += force_table(found, size.times)
        if not cross:
            lines += bars(found["joint"], size.times)
    return lines


def without_gyroscope(size: Size) -> list[str]:
    """What a consumer gets where the vehicle's yaw rate alone shows turns, and how soon."""
    found = traces(size, 0.02, has_gyro=False)
    lines = ["", f"### Without a gyroscope, {size.drives} drives, 2 % cross-axis error", ""]
    lines += [*force_table(found, size.times), ""]
    for name, of in found.items():
        after = np.nan_to_num([trace.usable_after for trace in of], nan=np.inf)
        middle, late = np.quantile(after, [0.5, 0.9], method="higher")
        lines.append(f"- {name}: *usable* after {middle:.0f} s of driving (90 %: {late:.0f} s).")
    return lines


def step_cost(size: Size) -> list[str]:
    """Median and largest processor time of one step."""
    made = drive(size.first, max(size.times))
    estimator = usual_estimator(FULL)
    times = []
    for row in made.rows.tolist():
        began = time.perf_counter_ns()
        estimator.step(row)
        times.append((time.perf_counter_ns() - began) / 1000.0)
    median, high = float(np.median(times)), float(np.quantile(times, 0.99))
    return [
        "",
        f"- One step (100 ms of data): median {median:.1f} us (bar 150: {verdict(median <= 150)}),"
        f" 99th percentile {high:.0f} us.",
    ]


def long_drives(size: Size) -> list[str]:
    """Pitch after four hours."""
    errors = []
    for seed in range(size.first + LONG_AT, size.first + LONG_AT + size.long_drives):
        made = drive(seed, size.long_minutes)
        trace = run(usual_estimator(FULL), made, [size.long_minutes])
        errors.append(trace.said[size.long_minutes].error)
        progress(f"long drive {seed - size.first - LONG_AT + 1} of {size.long_drives}")
    _, p90 = quantiles(np.array(errors)[:, 1])
    yaw, _ = quantiles(np.array(errors)[:, 2])
    hours = size.long_minutes / 60.0
    return [
        "",
        f"- Pitch after {hours:g} h, {size.long_drives} drives: 90th percentile {p90:.2f} deg"
        f" (bar 0.15: {verdict(p90 <= 0.15)}); yaw median {yaw:.3f} deg.",
    ]


def efficiency(size: Size) -> list[str]:
    """Yaw against the Cramer-Rao bound."""
    minutes = 10.0
    pairs = []
    for seed in range(size.first + BOUND_AT, size.first + BOUND_AT + size.bound_drives):
        pairs.append(error_and_bound(seed, minutes))
        progress(f"bound {len(pairs)} of {size.bound_drives}")
    error, bound = np.array(pairs).T
    squares = (error / bound) ** 2
    ratio = float(np.mean(squares))
    spread = float(np.std(squares)) / len(squares) ** 0.5
    return [
        "",
        f"- Efficiency, white noise only, {minutes:g} min, {size.bound_drives} drives: yaw mean"
        f" square error {ratio:.2f} +- {spread:.2f} times the Cramer-Rao bound (bar 1.5:"
        f" {verdict(ratio <= 1.5)}; bound {np.median(bound):.2f} deg in the median).",
    ]


def shifts(size: Size) -> list[str]:
    """Shifts of the sensor in mid-drive: how many are found, and when."""
    lines = ["", "### Shift in mid-drive", ""]
    lines += ["| shift | found in time | bar | median after | by the clock, stops included |"]
    lines += ["|---|---|---|---|---|"]
    for number, (axis, degrees, limit, bar) in enumerate(SHIFTS):
        after, n = [], size.shift_drives
        for k in range(n):
            seed = size.first + SHIFTS_AT + number * SHIFTS_APART + k
            rng = np.random.default_rng(seed)
            start = float(rng.uniform(900.0, 1200.0))
            change = {"t_s": start, f"{axis}_deg": degrees * float(rng.choice([-1.0, 1.0]))}
            made = drive(seed, 26.0, {"mount.shifts": [change]})
            estimator = usual_estimator(FULL)
            found = [t for t in run(estimator, made, []).bad_at if t > start]
            found += [t for t in _reported(estimator) if t > start]
            at = min(found, default=np.inf)
            after.append((driven(made, start, at) if found else np.inf, at - start))
            progress(f"shift {axis} {degrees:g} deg: {k + 1} of {n}")
        driving, clock = np.mean(np.array(after) <= limit, axis=0)
        lines.append(
            f"| {axis} {degrees:g} deg | {100 * driving:.0f} % of {n} within {limit / 60:g} min |"
            f" {100 * bar:.0f} %: {verdict(driving >= bar)} | {np.median(after, axis=0)[0]:.0f} s |"
            f" {100 * clock:.0f} % |"
        )
    return lines


def _reported(estimator: JointEstimator) -> list[float]:
    """Times of the shifts that were reported [s], those that mislead nobody too."""
    shifts = estimator.estimate().details["shifts"]
    assert isinstance(shifts, list)
    return [float(shift["t"]) for shift in shifts]


def false_alarms(size: Size) -> list[str]:
    """Shifts reported where there is none; and mounts that were doubted without one."""
    alarms = doubts = 0
    for k in range(size.quiet_drives):
        seed = size.first + QUIET_AT + k
        estimator = usual_estimator(FULL)
        bad = run(estimator, drive(seed, size.quiet_minutes), []).bad_at
        reported = _reported(estimator)
        if bad or reported:
            text = f"seed {seed}: shifts at {reported}, suspect at {bad}"
            print(text, file=sys.stderr, flush=True)
        alarms += len(reported)
        doubts += max(len(bad) - len(reported), 0)
        progress(f"quiet drive {k + 1} of {size.quiet_drives}: {alarms} alarms")
    hours = size.quiet_drives * size.quiet_minutes / 60.0
    rate = alarms / hours * 100.0
    return [
        "",
        f"- False alarms: {alarms} in {hours:g} h, {rate:.1f} per 100 h"
        f" (bar 1: {verdict(rate < 1.0)}).",
        f"- Without a shift being reported a usable mount was taken back {doubts} times, as its"
        " interval had become too wide again.",
    ]


PARTS: dict[str, Callable[[Size], list[str]]] = {
    "accuracy": accuracy,
    "no_gyroscope": without_gyroscope,
    "long": long_drives,
    "bound": efficiency,
    "cost": step_cost,
    "shifts": shifts,
    "alarms": false_alarms,
}


def progress(text: str) -> None:
    """Say on a terminal how far it is."""
    if sys.stderr.isatty():
        print(f"\r{text:60s}", end="", file=sys.stderr)


def written(name: str, lines: list[str]) -> None:
    """Put the figures of a part into the record, in place of its former ones."""
    begin, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
    page = PAGE.read_text(encoding="utf-8")
    head, rest = page.split(begin)
    _, tail = rest.split(end)
    figures = "\n".join(lines).strip("\n")
    PAGE.write_text(f"{head}{begin}\n\n{figures}\n\n{end}{tail}", encoding="utf-8")


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="a few short drives")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument(
        "--write", action="store_true", help="put the figures of these parts into the record"
    )
    parser.add_argument("--first", type=int, default=FIRST_SEED, help="first seed")
    parser.add_argument("--drives", type=int, help="of the part accuracy")
    options = parser.parse_args()
    size = replace(QUICK if options.quick else Size(), first=options.first)
    if options.drives:
        size = replace(size, drives=options.drives)
    if tuned := tuned_on(sorted(size.seeds())):
        parser.error(
            f"--first {size.first}: {len(tuned)} of its seeds were tuned on ({tuned[0]} ...)"
        )
    lines: list[str] = []
    for name in options.only:
        part = PARTS[name](size)
        print("\n".join(part), flush=True)
        lines += part
        if options.write:
            written(name, part)
    return 1 if any("NOT MET" in line for line in lines) else 0


if __name__ == "__main__":
    sys.exit(main())
