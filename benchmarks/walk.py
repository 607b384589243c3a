"""Direction of travel of a carried terminal: simulated gaits with truth, and a measured walk.

    python -m benchmarks.walk [simulated|measured ...]

The published method (D) and the alternative, on the same steps. Errors are circular, against the
true course: median and 90th percentile; the step count is against the true one.
"""

from __future__ import annotations

import csv
import gzip
import math
import sys
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from benchmarks.measured import DATA, MEASURED_DRIVES, ROOT, is_here, nothing_measured, verdict

sys.path.insert(0, str(ROOT / "tests"))

from gait import CARRYINGS, Walk, walk
from imucald.can.logs.log_reader import LogReader
from imucald.config.attitude import TravelDirectionSettings
from imucald.inputs.wiring import compile_router
from imucald.runtime.session import open_config
from imucald.travel_direction.direction import Step, TravelDirection

SPEEDS = (0.9, 1.3, 1.7)
SEEDS = (1, 2)
ETHZ_SPEED = 0.7
"""Course is taken where GNSS says at least so much [m/s]."""
ETHZ_ACCURACY = 12.0
"""And where it claims at least this accuracy [m]."""
FOLDER = Path(__file__).resolve().parent
METHODS = ("compass", "tilt", "correlation", "published", "alternative")


def steps_of(events: Iterable[tuple[str, float, Sequence[float]]]) -> list[Step]:
    """Feed samples in order; return the steps."""
    travel = TravelDirection(TravelDirectionSettings())
    steps: list[Step] = []
    for channel, t, values in events:
        if channel == "gyro":
            travel.gyro(t, values)
        elif channel == "mag":
            travel.mag(t, values)
        elif (step := travel.accel(t, values)) is not None:
            steps.append(step)
    return steps


def events_of(w: Walk) -> Iterable[tuple[str, float, Sequence[float]]]:
    for t, a, g, m in zip(
        w.t.tolist(), w.accel.tolist(), w.gyro.tolist(), w.mag.tolist(), strict=True
    ):
        yield "gyro", t, g
        yield "mag", t, m
        yield "accel", t, a


def headings(step: Step) -> dict[str, float | None]:
    p = step.published
    return {
        "compass": step.compass,
        "tilt": p.tilt_heading if p else None,
        "correlation": p.correlation_heading if p else None,
        "published": p.heading if p else None,
        "alternative": step.alternative,
    }


Errors = dict[str, list[float]]


def errors(steps: Sequence[Step], course_at: Sequence[float | None]) -> Errors:
    """Sizes of the errors [deg] by method; steps without a known course are left out."""
    found: Errors = {m: [] for m in METHODS}
    for step, course in zip(steps, course_at, strict=True):
        if course is None:
            continue
        for method, heading in headings(step).items():
            if heading is not None:
                error = abs(math.remainder(heading - course, 2.0 * math.pi))
                found[method].append(math.degrees(error))
    return found


def row(name: str, found: Errors, extra: str = "") -> str:
    cells = []
    for method in METHODS:
        e = found[method]
        cells.append(f"{np.median(e):5.0f} /{np.percentile(e, 90):4.0f}" if e else "     -     ")
    return f"| {name:<18} | " + " | ".join(cells) + f" | {extra:>9} |"


Sureness = list[tuple[float, float, bool]]
"""Error [deg], stated deviation [deg], ambiguous, of each step."""


def sureness(steps: Sequence[Step], course_at: Sequence[float | None]) -> Sureness:
    found: Sureness = []
    for step, course in zip(steps, course_at, strict=True):
        if course is not None and step.alternative is not None and step.deviation is not None:
            error = abs(math.remainder(step.alternative - course, 2.0 * math.pi))
            found.append((math.degrees(error), math.degrees(step.deviation), step.ambiguous))
    return found


def sure_row(name: str, found: Sureness) -> bool:
    """Print how the stated sureness holds; whether its bars are met."""
    e, std, ambiguous = (np.array(column) for column in zip(*found, strict=True))
    told = ~ambiguous.astype(bool)
    cover = 100.0 * float(np.mean((e < 1.96 * std)[told]))
    wrong = 100.0 * float(np.mean((e > 90.0) & told))
    left = f"| {name:<18} | {np.median(std):6.0f} deg | {cover:5.1f} % "
    missed = f"| {100 * np.mean(e > 90.0):8.2f} % | {wrong:8.2f} % |"
    print(f"{left}| {100 * np.mean(~told):6.1f} % {missed}")
    return 90 <= round(cover) <= 98 and wrong < 2.0


SURE_HEADER = (
    "\n| how sure           | deviation  | covered | ambiguous | sign wrong | and not told |"
)


def header() -> str:
    cells = " | ".join(f"{m:>11}" for m in METHODS)
    return f"| {'median / 90 % [deg]':<18} | {cells} | {'steps':>9} |"


def simulated() -> bool:
    print("\nSimulated gaits: seven ways to carry, three speeds, left and right, hard iron 6 uT\n")
    print(header())
    total: Errors = {m: [] for m in METHODS}
    sure: dict[str, Sureness] = {}
    worst_count = 0.0
    for carrying in CARRYINGS:
        found: Errors = {m: [] for m in METHODS}
        count = 0.0
        for speed in SPEEDS:
            for is_left in (False, True):
                for seed in SEEDS:
                    w = walk(carrying, speed, is_left, seed=seed)
                    steps = steps_of(events_of(w))
                    course = np.interp([s.t - 0.5 * s.duration for s in steps], w.t, w.course)
                    sure.setdefault(carrying.name, []).extend(sureness(steps, course.tolist()))
                    for method, e in errors(steps, course.tolist()).items():
                        found[method] += e
                    count = max(count, abs(len(steps) - w.steps) / w.steps)
        for method in METHODS:
            total[method] += found[method]
        worst_count = max(worst_count, count)
        print(row(carrying.name, found, f"{100.0 * count:.1f} %"))
    print(row("all", total, f"{100.0 * worst_count:.1f} %"))
    print(SURE_HEADER)
    is_sure = min(sure_row(name, found) for name, found in sure.items())
    is_better = np.median(total["alternative"]) <= np.median(total["published"])
    print("\nsteps: largest error of any walk; bar 3 %: " + verdict(worst_count <= 0.03))
    print(f"alternative at least as good: {verdict(bool(is_better))}")
    print(f"covered 90 to 98 %, sign wrong and not told under 2 %: {verdict(is_sure)}")
    return bool(is_better) and worst_count <= 0.03 and is_sure


def ethz_course() -> tuple[np.ndarray, np.ndarray]:
    rows = []
    with gzip.open(DATA / "ped_ethz" / "gnss_course.csv.gz", "rt") as file:
        for line in csv.DictReader(file):
            if (
                float(line["speed_mps"]) > ETHZ_SPEED
                and float(line["horizontal_accuracy_m"]) < ETHZ_ACCURACY
            ):
                course = math.radians(float(line["course_deg_from_north"]))
                rows.append((float(line["time_s"]), course))
    t, course = np.array(rows).T
    return t, np.exp(1j * course)


def course_at(t: float, times: np.ndarray, courses: np.ndarray) -> float | None:
    """Course between two fixes not more than 2.5 s apart [rad]."""
    i = int(np.searchsorted(times, t))
    if not 0 < i < len(times) or times[i] - times[i - 1] > 2.5:
        return None
    part = (t - times[i - 1]) / (times[i] - times[i - 1])
    return float(np.angle(courses[i - 1] * (1.0 - part) + courses[i] * part))


def measured() -> bool:
    print("\nMeasured walk ped_ethz (phone, magnetically disturbed) against GNSS course\n")
    loaded = open_config(MEASURED_DRIVES / "ped_ethz.yaml")
    router = compile_router(loaded)
    found: list[tuple[float, int, str, list[float]]] = []
    for chunk in LogReader([DATA / "ped_ethz" / "drive.log.gz"], router.matches):
        for channel, series in router.columns(chunk.t, chunk).samples.items():
            order = ("gyro", "mag", "accel").index(channel)
            values = series.values.tolist()
            found += [
                (t, order, channel, v) for t, v in zip(series.t.tolist(), values, strict=True)
            ]
    found.sort(key=lambda e: e[:2])
    steps = steps_of((channel, t, v) for t, _, channel, v in found)
    times, courses = ethz_course()
    known = [course_at(s.t, times, courses) for s in steps]
    by_method = errors(steps, known)
    print(header())
    print(row("ped_ethz", by_method, str(len(steps))))
    print(SURE_HEADER)
    is_sure = sure_row("ped_ethz", sureness(steps, known))
    times_between = [b.t - a.t for a, b in pairwise(steps)]
    print(f"\n{len(steps)} steps, median {np.median(times_between):.2f} s; "
          f"{len(by_method['published'])} with a course")  # fmt: skip
    is_better = all(
        np.percentile(by_method["alternative"], q) <= np.percentile(by_method["published"], q)
        for q in (50, 90)
    )
    print(f"alternative at least as good: {verdict(is_better)}")
    print(f"covered 90 to 98 %, sign wrong and not told under 2 %: {verdict(is_sure)}")
    return is_better and is_sure


PARTS = {"simulated": simulated, "measured": measured}


def main() -> int:
    chosen = sys.argv[1:] or list(PARTS)
    has_walk = is_here("ped_ethz")
    met = [PARTS[name]() for name in chosen if has_walk or name != "measured"]
    if "measured" in chosen and not has_walk:
        return nothing_measured("ped_ethz")
    return 0 if all(met) else 1


if __name__ == "__main__":
    sys.exit(main())
