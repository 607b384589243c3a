"""What a model file is worth while driving, effect by effect (records/model-compensation.md).

    python -m benchmarks.model_compensation [--seeds 8] [--minutes 12] [--only EFFECT ...] [--write]

Simulated drives with everything that `imucald.simulation.random_model` has, and one effect more.
*Before*: the daemon with a model file that knows all but the effect. *After*: with the effect in
it. *10 % off*: with an effect in it that is a tenth too large. Errors of the corrected signals are
those of 0.5 s means while moving, against the truth in the axes of the road, from the third minute
on: `own` with the true mount, `all` with the one that was found on the way. Rms over the drives.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the matrices are small

import argparse
import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.corrected_drive import corrected_drive, corrected_with
from benchmarks.measured import ROOT
from benchmarks.truth_error import drive_errors
from imucald.config.vehicle import VehicleSettings
from imucald.model_compensation import ModelCompensation, compensation_from_model
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.simulation import Drive, VehicleModel, random_model, simulate

FIRST_SEED = 7000
FROM_S = 180.0
BEGIN, END = "<!-- figures -->", "<!-- end of figures -->"
PAGE = ROOT / "benchmarks" / "records" / "model-compensation.md"
DEG = np.pi / 180.0
OWN_TURNING = ("gyro",)
STABILITY = ("gyro", "yaw_rate")


@dataclass(frozen=True)
class Effect:
    """An effect: what it adds to the keys of a model (relative to 1), and channels to do without.

    text: in words, with its size.
    """

    text: str
    added: Mapping[str, Any]
    without: tuple[str, ...] = ()


EFFECTS: Mapping[str, Effect] = {
    "nothing": Effect("none (drives as they are)", {}),
    "accel_bias": Effect(
        "accelerometer bias 0.25 m/s² on an axis each", {"accel.bias": (0.14, -0.14, 0.15)}
    ),
    "accel_scale": Effect("accelerometer scale 4 %", {"accel.scale": (0.04, 0.04, 0.04)}),
    "accel_scale_z": Effect("the same, one axis", {"accel.scale": (0.0, 0.04, 0.0)}),
    "accel_cross_axis": Effect(
        "cross-axis 3 %", {"accel.cross_axis": (0.03, 0.0, 0.0, -0.03, 0.03, 0.0)}
    ),
    "accel_bias_temperature": Effect(
        "accelerometer 0.01 m/s²/K", {"accel.bias_temperature": (0.006, -0.006, 0.006)}
    ),
    "gyro_bias": Effect("gyroscope bias 0.6 deg/s", {"gyro.bias": (0.35 * DEG,) * 3}),
    "gyro_scale": Effect("gyroscope scale 5 %", {"gyro.scale": (0.05, 0.05, 0.05)}),
    "gyro_bias_temperature": Effect(
        "gyroscope 0.03 deg/s/K", {"gyro.bias_temperature": (0.017 * DEG,) * 3}
    ),
    "g_sensitivity": Effect(
        "g-sensitivity 0.06 (deg/s)/(m/s²)", {"gyro.g_sensitivity": (0.06 * DEG,) * 3}
    ),
    "lever_arm": Effect("lever arm 2 m", {"mount.lever_arm_m": (1.9, 0.3, 0.5)}),
    "squat_dive": Effect(
        "squat and dive +0.005 rad/(m/s²)",
        {"suspension.squat_gradient": 0.005, "suspension.dive_gradient": 0.005},
    ),
    "squat_alone": Effect("squat alone +0.005", {"suspension.squat_gradient": 0.005}),
    "body_roll": Effect("body roll +0.009 rad/(m/s²)", {"suspension.roll_gradient": 0.009}),
    "speed_delay": Effect("speed later by 0.4 s", {"speed.delay_s": 0.4}),
    "accel_delay": Effect("accelerometer later by 0.15 s", {"accel.delay_s": 0.15}),
    "gyro_delay": Effect("gyroscope later by 0.15 s", {"gyro.delay_s": 0.15}),
    "speed_scale": Effect(
        "speed and wheels 5 % high", {"speed.scale": 0.05, "wheel_speeds.scale": (0.05,) * 4}
    ),
    "yaw_rate": Effect(
        "yaw rate 6 % high, 0.7 deg/s off (no gyroscope)",
        {"yaw_rate.scale": 0.06, "yaw_rate.offset": 0.7 * DEG},
        OWN_TURNING,
    ),
    "steering": Effect(
        "steering 5 deg off, ratio 15 % high (no gyroscope, no yaw rate)",
        {"steering.offset": 5.0 * DEG, "chassis.steering_ratio": 2.3},
        STABILITY,
    ),
}


def with_effect(model: VehicleModel, effect: Effect, part: float = 1.0) -> VehicleModel:
    """The model with so much of the effect added."""
    data = model.dump()
    changes: dict[str, Any] = {}
    for key, added in effect.added.items():
        section, name = key.split(".")
        now = data[section][name]
        if isinstance(added, tuple):
            changes[key] = [x + part * a for x, a in zip(now, added, strict=True)]
        else:
            changes[key] = now + part * added
    return model.with_changes(changes)


@dataclass(frozen=True)
class Row:
    """Errors of one way to run the drives, (drives, 9).

    Force forward, left, up with the true mount, rate; force, rate with the mount that was found;
    its roll, pitch, yaw.
    """

    values: np.ndarray

    @property
    def rms(self) -> np.ndarray:
        """Over the drives (9,); NaN where there is nothing."""
        known = np.isfinite(self.values)
        total = np.where(known, self.values**2, 0.0).sum(axis=0)
        return np.sqrt(total / np.where(known.any(axis=0), known.sum(axis=0), np.nan))


def errors(drive: Drive, effect: Effect, compensation: ModelCompensation | None) -> np.ndarray:
    samples = {c: s for c, s in drive.samples.items() if c not in effect.without}
    chassis = drive.model.chassis
    settings = EstimatorSettings(
        vehicle=VehicleSettings(
            driving_side=drive.model.route.driving_side,
            steering_ratio=chassis.steering_ratio,
            wheelbase=chassis.wheelbase_m,
        ),
        uses_steering=True,
    )
    truth = drive.truth
    R = truth.R_vehicle_from_sensor()
    own = drive_errors(corrected_with(samples, compensation, R), truth, from_s=FROM_S)
    found = drive_errors(corrected_drive(samples, compensation, settings), truth, from_s=FROM_S)
    sizes = [np.linalg.norm(x) for x in (own.gyro, found.accel, found.gyro)]
    return np.concatenate([own.accel, sizes, found.mount])


def rows_of(effect: Effect, seeds: Sequence[int], minutes: float) -> list[Row]:
    """Without a model, before, after, 10 % off."""
    found: list[list[np.ndarray]] = [[], [], [], []]
    for seed in seeds:
        base = random_model(seed, "mixed")
        drive = simulate(with_effect(base, effect), seed, minutes)
        known = (None, base, with_effect(base, effect), with_effect(base, effect, 1.1))
        for rows, model in zip(found, known, strict=True):
            compensation = None if model is None else compensation_from_model(model.dump())
            rows.append(errors(drive, effect, compensation))
    return [Row(np.array(rows)) for rows in found]


COLUMNS = (
    "own: forward", "left", "up", "rate", "all: force", "rate", "mount: roll", "pitch", "yaw",
)  # fmt: skip
UNITS = ("m/s²", "m/s²", "m/s²", "deg/s", "m/s²", "deg/s", "deg", "deg", "deg")
FORMS = (".3f", ".3f", ".3f", ".2f", ".3f", ".2f", ".2f", ".2f", ".2f")
HEAD = "\n".join(
    (
        "| effect | | " + " | ".join(COLUMNS) + " |",
        "|---|---|" + "---|" * len(COLUMNS),
        "| | | " + " | ".join(UNITS) + " |",
    )
)
NAMES = ("no model", "before", "after", "10 % off")


def table_rows(effect: Effect, rows: Sequence[Row]) -> list[str]:
    lines = []
    for name, row in zip(NAMES, rows, strict=True):
        if not effect.added and name in NAMES[1::2]:
            continue
        if effect.added and name == NAMES[0]:
            continue
        r = row.rms
        cells = [f"{x:{f}}" if np.isfinite(x) else "-" for x, f in zip(r, FORMS, strict=True)]
        label = effect.text if name in NAMES[:2] else ""
        lines.append(f"| {label} | {name} | " + " | ".join(cells) + " |")
    return lines


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--minutes", type=float, default=12.0)
    parser.add_argument("--only", nargs="*", choices=sorted(EFFECTS), default=None)
    parser.add_argument("--cost", action="store_true", help="only: time of a sample, live")
    parser.add_argument("--write", action="store_true", help="write the table into the docs")
    options = parser.parse_args()
    if options.cost:
        print(f"{cost() * 1e6:.2f} us a sample, all terms, mean of force and rate")
        return 0
    seeds = range(FIRST_SEED, FIRST_SEED + options.seeds)
    lines = HEAD.splitlines()
    print(HEAD, flush=True)
    for name, effect in EFFECTS.items():
        if options.only and name not in options.only:
            continue
        found = table_rows(effect, rows_of(effect, seeds, options.minutes))
        lines += found
        print("\n".join(found), flush=True)
    if options.write:
        write(lines, options.seeds, options.minutes)
    return 0


COST_SAMPLES = 20_000
EVERYTHING = {
    "accel": {"bias": [0.1] * 3, "scale": [0.01] * 3, "bias_temperature": [0.001] * 3},
    "gyro": {"bias": [0.01] * 3, "scale": [0.01] * 3, "g_sensitivity": [0.001] * 3},
    "mount": {"lever_arm_m": [1.5, 0.2, 0.3]},
    "suspension": {"squat_gradient": 0.0035, "dive_gradient": 0.004, "roll_gradient": 0.008},
}


def cost() -> float:
    """Processor time that a model adds to a live sample [s]: the least of seven runs."""
    model = {k: {**v, "full_scale": 39.2} if k == "accel" else v for k, v in EVERYTHING.items()}
    compensation = compensation_from_model(model)
    force, rate = [("accel", (0.1, 0.2, 9.8))], [("gyro", (0.01, 0.02, 0.2))]
    took = []
    for _ in range(7):
        preprocessing = compensation.preprocessing_chain(
            {"accel", "gyro", "temperature"}, derived_speed=False
        )
        rejected: Counter[str] = Counter()
        preprocessing.frame(0.0, [("temperature", (40.0,))], rejected)
        began = time.process_time()
        for i in range(COST_SAMPLES):
            t = 0.005 * i
            out, _ = preprocessing.frame(t, rate if i % 2 else force, rejected)
            preprocessing.corrected(t, {out[0][0]: out[0][1]})
        took.append((time.process_time() - began) / COST_SAMPLES)
    return min(took)


def write(lines: Sequence[str], seeds: int, minutes: float) -> None:
    text = PAGE.read_text()
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    note = f"{seeds} drives of {minutes:g} min each, from seed {FIRST_SEED} on.\n\n"
    PAGE.write_text(before + BEGIN + "\n" + note + "\n".join(lines) + "\n" + END + after)


if __name__ == "__main__":
    sys.exit(main())
