"""Which faults are judged, by which bars, and in which drives they are put."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.integrity import faults
from benchmarks.integrity.bases import Base
from benchmarks.integrity.faults import Edit, Put
from benchmarks.integrity.judge import Allowed

FIRST_SEED = 600_000
"""Nothing was tuned from here on: below lie the seeds of `mount_accuracy` and of the diagnosis."""
MINUTES = 20.0
QUIET_MINUTES = 60.0
QUIET_HOURS = 300
QUIET_SEEDS = 10_000
"""The drives without a fault begin so far from the others."""
DRIVES = 20
TIMES = 5
"""Strata of the time at which a fault is put in; the last is while parked."""
EARLIEST_S = 60.0
ROOM_S = 240.0
"""So much of a drive is left after the fault, where it is long enough."""
LOGS = (
    "kingston_2008",
    "css_canmod_164",
    "vehsense_2018_08_04",
    "vehsense_2017_10_23_2245",
    "vehsense_2017_10_25_1829",
    "second_world/01_none",
    "second_world/02_none",
    "second_world/12_crosswind_gusts",
)
"""Measured logs (and another simulator's) that faults are put into."""
WORLD = (
    "01_none", "02_none", "03_steering_ratio_error", "04_understeer", "05_accel_bias",
    "06_accel_cross_axis", "07_steering_delay", "08_imu_lowpass", "09_frame_dropout",
    "10_body_roll", "11_accel_saturation", "12_crosswind_gusts",
    "13_steering_offset_and_speed_scale", "14_mount_shift_at_200_s",
)  # fmt: skip


SHIFTED = "second_world/14_mount_shift_at_200_s"
SATURATED = "second_world/11_accel_saturation"

AT_ONCE = Allowed()
SOON = Allowed(clock=2.0)
CLIPPED = Allowed(driving=60.0)
FOUND = Allowed(driving=60.0)
SMALL_FOUND = Allowed(driving=150.0)
LATEST_FOUND_S = 120.0
"""Of driving, within which 99 % of the remounts of 10 deg or more are found."""


@dataclass(frozen=True)
class Row:
    """A fault of a size, a line of the table.

    bar: of the issue. allowed: time to alert. times: how many times the drives. whole: it is there
    all the time. checked: `check` looks at it as well. shown_by: channels of which one must be
    there, or no signal of the drive is other than in a sound one.
    """

    part: str
    name: str
    bar: int
    edit: Edit
    allowed: Allowed = AT_ONCE
    times: int = 1
    whole: bool = True
    checked: bool = False
    shown_by: frozenset[str] = frozenset()

    def is_shown(self, channels: frozenset[str]) -> bool:
        """Whether any signal of a drive with these channels shows it."""
        return not self.shown_by or bool(self.shown_by & channels)


SIDED = frozenset({"steering", "lateral_accel", "wheel_speeds"})
"""They know left from right of the vehicle, and so its front from its rear."""

ROWS = (
    Row("values", "frozen sensor", 2, faults.frozen_sensor, SOON, whole=False),
    Row("values", "frozen axis", 2, faults.frozen_axis, SOON, whole=False),
    Row("values", "dead axis", 2, faults.dead_axis, SOON, whole=False),
    Row("values", "unit change", 2, faults.unit_change, SOON, whole=False),
    Row("values", "clipped axis", 2, faults.clipped_axis, CLIPPED, whole=False),
    Row("remount", "remount 4 deg", 3, faults.remount(4.0), SMALL_FOUND, 2, whole=False),
    Row("remount", "remount 10 deg", 3, faults.remount(10.0), FOUND, 2, whole=False),
    Row("remount", "remount 45 deg", 3, faults.remount(45.0), FOUND, 2, whole=False),
    Row("remount", "remount 90 deg", 3, faults.remount(90.0), FOUND, 2, whole=False),
    *(Row("creep", f"creep {rate:g} deg/h", 4, faults.creep(rate)) for rate in (5.0, 18.0, 72.0)),
    *(
        Row("errors", f"cross-axis {100 * share:g} %", 5, faults.cross_axis(share))
        for share in (0.005, 0.01, 0.02, 0.04)
    ),
    Row("errors", "antisymmetric 4 %", 5, faults.antisymmetric(0.04)),
    Row("errors", "gyroscope axes 3 %", 5, faults.cross_axis(0.03, "gyro")),
    Row("errors", "gyroscope turned by 1 deg", 5, faults.turned_gyroscope(1.0)),
    Row("errors", "mixture", 5, faults.mixture),
    Row("errors", "gain of an axis 3 %", 5, faults.gain(0.03)),
    Row("errors", "gain of an axis 10 %", 5, faults.gain(0.1)),
    Row(
        "signs",
        "all accelerometer signs",
        6,
        faults.all_signs,
        checked=True,
        shown_by=SIDED | {"yaw_rate"},
    ),
    Row("signs", "one accelerometer sign", 6, faults.one_sign, checked=True),
    Row("signs", "accelerometer axes exchanged", 6, faults.accel_exchanged, checked=True),
    Row("signs", "gyroscope axes exchanged", 6, faults.gyro_exchanged, checked=True),
    Row("signs", "handedness", 6, faults.handedness, checked=True),
    Row("signs", "gyroscope 57.3 times", 6, faults.gyro_units(faults.DEG), checked=True),
    Row("signs", "gyroscope 25 times", 6, faults.gyro_units(25.0), checked=True),
    Row("signs", "speed x 3.6", 6, faults.speed_units(3.6), checked=True),
    Row("signs", "speed / 3.6", 6, faults.speed_units(1.0 / 3.6), checked=True),
    Row("signals", "speed 1.19 x wheels", 7, faults.speed_against_wheels, checked=True),
    Row("signals", "steering sign", 7, faults.steering_sign, checked=True),
    Row(
        "signals",
        "reversing, no reverse signal",
        7,
        faults.reversing,
        checked=True,
        shown_by=SIDED | {"longitudinal_accel"},
    ),
    Row("signals", "rates 57.3 times too small", 7, faults.small_rates, whole=False),
    Row("signals", "speed stuck", 7, faults.speed_stuck, whole=False),
    Row("steps", "zero steps by 1 m/s2", 7, faults.zero_step(1.0), FOUND, whole=False),
    Row("steps", "gain steps by 10 %", 7, faults.gain_step(0.1), FOUND, whole=False),
    Row("steps", "gyroscope sign turns", 7, faults.gyro_sign, FOUND, whole=False),
    Row("signals", "reverse turned round", 7, faults.reverse_turned_round, checked=True),
    Row("signals", "reverse stuck on", 7, faults.reverse_stuck_on, FOUND, whole=False),
)
QUIET = Row("quiet", "no fault", 1, faults.none)
AS_RECORDED = Row("recorded", "as recorded", 9, faults.none)
PARTS = ("quiet", *dict.fromkeys(row.part for row in ROWS), "recorded")
_NAMED = {row.name: row for row in (*ROWS, QUIET, AS_RECORDED)}


@dataclass(frozen=True)
class Case:
    """One drive to judge. base: a seed, or the name of a measured log. number: of the fault's."""

    row: str
    base: str
    number: int
    minutes: float

    @property
    def fault(self) -> Row:
        """The line of the table that it counts for."""
        return _NAMED[self.row]

    @property
    def key(self) -> str:
        """Names it in the file of results."""
        return f"{self.fault.part}/{self.row}/{self.base}/{self.number}/{self.minutes:g}"


@dataclass(frozen=True)
class Size:
    """How much is judged. logs: how many of the measured ones."""

    drives: int = DRIVES
    first: int = FIRST_SEED
    hours: int = QUIET_HOURS
    minutes: float = MINUTES
    quiet_minutes: float = QUIET_MINUTES
    logs: int = len(LOGS)
    world: int = len(WORLD)


QUICK = Size(drives=1, hours=1, minutes=10.0, quiet_minutes=20.0, logs=1, world=2)


def cases(size: Size, parts: tuple[str, ...]) -> Iterator[Case]:
    """All cases, drive by drive, so that each is read once."""
    rows = [row for row in ROWS if row.part in parts]
    if "recorded" in parts:
        for name in WORLD[-size.world :]:
            yield Case(AS_RECORDED.name, f"second_world/{name}", 0, 0.0)
        for log in [log for log in LOGS[: size.logs] if not log.startswith("second_world")]:
            yield Case(AS_RECORDED.name, log, 0, 0.0)
    for i in range(size.drives):
        for row in rows:
            for k in range(row.times):
                yield Case(row.name, str(size.first + i), i * row.times + k, size.minutes)
    for i, log in enumerate(LOGS[: size.logs]):
        for row in rows:
            yield Case(row.name, log, i + 1, 0.0)
    if "quiet" in parts:
        for i in range(round(size.hours * 60.0 / size.quiet_minutes)):
            seed = size.first + QUIET_SEEDS + i
            yield Case(QUIET.name, str(seed), i, size.quiet_minutes)


def put(case: Case, base: Base) -> Put:
    """When, about which axis and to which side the fault of a case is put in.

    Times, axes and sides go round with numbers that share no divisor, so that all pairs come.
    """
    order = [row.name for row in ROWS].index(case.row) if case.fault in ROWS else 0
    rng = np.random.default_rng([order, case.number, base.seed or 0])
    sign = 1.0 if rng.random() < 0.5 else -1.0
    start = 0.0 if case.fault.whole else _start(base, case.number % TIMES, rng)
    return Put(start, case.number, sign, case.number % 2 == 0, rng)


def _start(base: Base, stratum: int, rng: np.random.Generator) -> float:
    last = max(base.duration_s - ROOM_S, 0.5 * base.duration_s)
    if stratum == TIMES - 1:
        stops = base.parked(EARLIEST_S, last)
        if stops:
            first, stop = stops[int(rng.integers(len(stops)))]
            return 0.5 * (first + stop)
    if base.seed is not None:
        edges = [EARLIEST_S, 150.0, 300.0, 600.0, last, last]
    else:
        edges = [
            EARLIEST_S + part * (last - EARLIEST_S) for part in (0.0, 0.25, 0.5, 0.75, 1.0, 1.0)
        ]
    low, high = min(edges[stratum], last), min(edges[stratum + 1], last)
    return float(rng.uniform(EARLIEST_S if low >= high else low, high))
