"""Warm start on simulated drives: what a known sensor is worth, and whether a moved one shows.

    python -m benchmarks.warm_start [--seeds 20] [--first 20] [--minutes 12] [--from 400000]

Each vehicle drives twice on different roads. Its state of the first drive is saved and serves in
the second, with what it found of the sensor and without; before the second drive load and springs
turn the body by a random amount (`BETWEEN_DRIVES_STD`). In some cases somebody moves the sensor as
well, about a random axis, before the drive or in it (`TURNED_AT_S`). Told are when the mount was
confirmed, when its yaw was as certain as before the restart again, when it was called suspect,
rightly or wrongly, and errors on the way.

    python -m benchmarks.warm_start --sensor [--seeds 6] [--from 979000] [--first 20] [--minutes 8]

The same with cross-axis terms of 2 %: when the mount is *usable* from nothing, after a restart with
the rotation alone and with the sensor, and in a new mount, where the old mount is still in front
and where it was forgotten. Told are the times, and cross-talk xy and yx there over the stated
deviation.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from benchmarks.mount_accuracy.seeds import FIRST_SEED, tuned_on
from imucald.core.rotations import rotation_from_vector, vector_from_rotation
from imucald.motion.column_ticks import ticks_from_samples
from imucald.mount.estimate import BETWEEN_DRIVES_STD, MountEstimator, MountState
from imucald.mount.estimator import JointEstimator
from imucald.mount.joint.known import known_from
from imucald.mount.mount_in_force import mount_in_force
from imucald.mount.restored import Phase, RestoredEstimator, StoredMount
from imucald.runtime.estimators import estimator_for
from imucald.runtime.session import open_config
from imucald.simulation import Drive, VehicleModel, random_model, simulate
from imucald.simulation.imu import gain_matrix

CONFIG = Path(__file__).parent.parent / "config" / "examples" / "passenger_car.yaml"
MOVED_DEG = (0.0, 2.0, 5.0, 8.0)
USAGE = 2
TURNED_DEG, TURNED_AT_S = 4.0, 240.0
"""In the last case the sensor is turned by that while driving."""
WHILE_DRIVING = -1.0
TURNED = f"turned by {TURNED_DEG:g} deg while driving"
SECOND_ROADS = 500_000
"""Added to a seed for the roads of the second drive."""
LOOKS_S = (120.0, 180.0, 300.0, 480.0, 720.0)
ALIKE = 1.25
"""Yaw counts as certain as before up to so many times its standard deviation of then."""
GOOD = (MountState.USABLE, MountState.FINE)


@dataclass
class Course:
    """Times [s] in the second drive, infinite where something did not happen.

    confirmed: the new evidence agreed. precise: yaw as certain as before the restart again.
    error, std: of the served mount at `LOOKS` (n, 3) [deg]. scaled: errors over claimed std there.
    """

    confirmed: float
    precise: float
    doubted: float
    error: NDArray[np.float64]
    std: NDArray[np.float64]


def rows_of(drive: Drive, minutes: float) -> list[list[float]]:
    """Ticks of a drive."""
    return list(ticks_from_samples(drive.samples, 0, int(minutes * 600)).tolist())


def stored_after(estimator: MountEstimator, rows: list[list[float]]) -> StoredMount | None:
    """What the first drive leaves; None where it ends without a good mount."""
    for row in rows:
        estimator.step(row)
    stored = mount_in_force(estimator)
    if estimator.state not in GOOD or stored is None or stored.sensor is None:
        return None
    return replace(stored, sensor=known_from(json.loads(json.dumps(stored.sensor.plain()))))


def turned_while_driving(model: VehicleModel, axis: NDArray[np.float64]) -> VehicleModel:
    """The same vehicle, whose sensor is turned about an axis of the vehicle in the drive."""
    roll, pitch, yaw = (TURNED_DEG * axis).tolist()
    shift = {"t_s": TURNED_AT_S, "roll_deg": roll, "pitch_deg": pitch, "yaw_deg": yaw}
    return model.with_changes({"mount.shifts": [shift]})


def course(
    estimator: RestoredEstimator, rows: list[list[float]], truth: NDArray[np.float64], begin: float
) -> Course:
    """Run the second drive. begin: doubts count from there, times as well [s]."""
    stored = estimator.stored
    before = math.sqrt(float(stored.covariance[2, 2]))
    confirmed = precise = doubted = math.inf
    errors, stds = [], []
    for k, row in enumerate(rows):
        estimator.step(row)
        t = (k + 1) / 10.0
        if estimator.phase not in (Phase.RESTORED, Phase.DOUBTED):
            confirmed = min(confirmed, t)
        if estimator.state in (MountState.SUSPECT, MountState.RECALIBRATING):
            doubted = min(doubted, t - begin) if t > begin else -math.inf
        if k % 10 != 9:
            continue
        std = estimator.estimate().std
        assert std is not None
        if estimator.phase is Phase.NEW and std[2] <= ALIKE * before:
            precise = min(precise, t)
        if t in LOOKS_S:
            assert estimator.correction is not None
            now = estimator.correction.matrix()
            errors.append(np.degrees(vector_from_rotation(truth @ now.T)))
            stds.append(np.degrees(std))
    return Course(confirmed, precise, doubted, np.array(errors), np.array(stds))


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--from", type=int, default=FIRST_SEED, dest="start", metavar="SEED")
    parser.add_argument("--first", type=float, default=20.0, metavar="MIN")
    parser.add_argument("--minutes", type=float, default=12.0)
    parser.add_argument("--sensor", action="store_true", help="when it is usable")
    options = parser.parse_args()
    seeds = range(options.start, options.start + options.seeds)
    if tuned := tuned_on(seeds):
        print(f"--from {options.start}: seed {tuned[0]} was tuned on", file=sys.stderr)
        return USAGE
    if options.sensor:
        return known_sensors(seeds, options.first, options.minutes)
    config = open_config(CONFIG).config
    found: dict[tuple[float, bool], list[Course]] = {
        (degrees, kept): [] for degrees in (*MOVED_DEG, WHILE_DRIVING) for kept in (False, True)
    }
    for seed in seeds:
        model = random_model(seed)
        first = rows_of(simulate(model, seed, options.first), options.first)
        stored = stored_after(estimator_for(config), first)
        if stored is None:
            print(f"seed {seed}: the first drive leaves no state")
            continue
        random = np.random.default_rng(seed)
        load = random.normal(0.0, BETWEEN_DRIVES_STD)
        axis = random.normal(0.0, 1.0, 3)
        axis /= np.linalg.norm(axis)
        for driven in (model, turned_while_driving(model, axis)):
            drive = simulate(driven, seed + SECOND_ROADS, options.minutes)
            rows, truth = rows_of(drive, options.minutes), drive.truth.mounts[-1][1]
            for (degrees, kept), courses in found.items():
                if (degrees == WHILE_DRIVING) == (driven is model):
                    continue
                parked = 0.0 if degrees == WHILE_DRIVING else math.radians(degrees)
                then = stored if kept else replace(stored, sensor=None, applied=None, sent=None)
                then = turned_by(then, rotation_from_vector(load + parked * axis))
                begin = TURNED_AT_S if degrees == WHILE_DRIVING else 0.0
                restored = RestoredEstimator(estimator_for(config), then)
                courses.append(course(restored, rows, truth, begin))
    for (degrees, kept), courses in found.items():
        what = f"moved {degrees:g} deg" if degrees != WHILE_DRIVING else TURNED
        looks = range(len(LOOKS_S)) if degrees == 0.0 else [len(LOOKS_S) - 1]
        print(f"{what}, sensor {'known' if kept else 'unknown'}: {told(courses, looks)}")
    return 0


REMOUNTED = {"mount.roll_deg": 9.0, "mount.pitch_deg": -14.0, "mount.yaw_deg": 63.0}
CROSS_AXIS = 0.02
CASES = ("from nothing", "restarted, rotation alone", "restarted, sensor known",
         "remounted, old mount in front", "remounted, old mount in front, sensor known",
         "remounted, old mount forgotten, sensor known")  # fmt: skip


def known_sensors(seeds: Sequence[int], first: float, minutes: float) -> int:
    """When the joint estimator is usable, by what it knows at the start."""
    config = open_config(CONFIG).config
    found: dict[str, list[tuple[float, float]]] = {case: [] for case in CASES}
    for seed in seeds:
        model = random_model(seed, cross_axis=CROSS_AXIS)
        rows = rows_of(simulate(model, seed, first), first)
        stored = stored_after(estimator_for(config), rows)
        if stored is None:
            print(f"seed {seed}: the first drive leaves no state")
            continue
        alone = replace(stored, sensor=None, applied=None, sent=None)
        load = rotation_from_vector(np.random.default_rng(seed).normal(0.0, BETWEEN_DRIVES_STD))
        same = simulate(model, seed + SECOND_ROADS, minutes)
        turned = simulate(model.with_changes(REMOUNTED), seed + SECOND_ROADS, minutes)
        afresh = estimator_for(config)
        assert isinstance(afresh, JointEstimator)
        assert stored.sensor is not None
        afresh.take_known_sensor(stored.sensor, is_moved=True)
        cases = (
            (same, estimator_for(config)),
            (same, RestoredEstimator(estimator_for(config), turned_by(alone, load))),
            (same, RestoredEstimator(estimator_for(config), turned_by(stored, load))),
            (turned, RestoredEstimator(estimator_for(config), alone)),
            (turned, RestoredEstimator(estimator_for(config), stored)),
            (turned, afresh),
        )
        for case, (drive, estimator) in zip(CASES, cases, strict=True):
            found[case].append(usable_from(estimator, drive, minutes))
            print(f"seed {seed}: {case}: {found[case][-1][0]:.0f} s", flush=True)
    for case, courses in found.items():
        times, ratios = np.array(courses).T
        stated = ratios[np.isfinite(ratios)]
        error = f", error over stated there rms {rms(stated):.2f}" if len(stated) else ""
        print(f"{case}: usable after {np.median(times):.0f} s (median of {len(times)}; at most "
              f"{times.max():.0f} s){error}")  # fmt: skip
    return 0


def turned_by(stored: StoredMount, R: NDArray[np.float64]) -> StoredMount:
    """The same, as if load had turned the body by so much since."""
    kept = stored.sensor
    if kept is not None:
        kept = kept._replace(rotation=R @ kept.rotation)
    return replace(stored, R_vehicle_from_sensor=R @ stored.R_vehicle_from_sensor, sensor=kept)


def usable_from(estimator: MountEstimator, drive: Drive, minutes: float) -> tuple[float, float]:
    """When it was usable [s], and the larger of cross-talk xy and yx 10 s later over its stated
    deviation; infinite and NaN where it never was."""
    R, accel = drive.truth.mounts[-1][1], gain_matrix(drive.model.accel)
    at = math.inf
    for k, row in enumerate(rows_of(drive, minutes)):
        estimator.step(row)
        if estimator.state in GOOD:
            at = min(at, (k + 1) / 10.0)
        if (k + 1) / 10.0 >= at + 10.0:
            break
    applied, sent = estimator.correction, estimator.estimate().deviations
    if applied is None or sent is None:
        return at, math.nan
    left = np.array(applied.force).reshape(3, 3) @ accel @ R.T
    return at, max(abs(left[0, 1]) / sent.xy, abs(left[1, 0]) / sent.yx)


def rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def told(courses: list[Course], looks: Sequence[int]) -> str:
    n = len(courses)
    texts = []
    early = sum(c.doubted == -math.inf for c in courses)
    if early:
        texts.append(f"doubted wrongly {early}")
    for what in ("confirmed", "precise", "doubted"):
        times = np.array([getattr(c, what) for c in courses])
        times = times[np.isfinite(times)]
        texts.append(f"{what} {len(times)} of {n}")
        if len(times):
            texts[-1] += f" (median {np.median(times):.0f} s, at most {times.max():.0f} s)"
    error, std = np.array([c.error for c in courses]), np.array([c.std for c in courses])
    lines = [", ".join(texts)]
    for i in looks:
        size = np.linalg.norm(error[:, i], axis=1)
        ratio = np.sqrt(np.mean((error[:, i] / std[:, i]) ** 2, axis=0))
        r, p, y = np.median(std[:, i], axis=0)
        lines.append(
            f"  after {LOOKS_S[i] / 60:3.0f} min: error {np.median(size):.2f},"
            f" at most {size.max():.2f} deg; claimed roll {r:.2f}, pitch {p:.2f}, yaw {y:.2f} deg;"
            f" error in claimed {ratio[0]:.2f}, {ratio[1]:.2f}, {ratio[2]:.2f}"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
