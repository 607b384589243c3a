"""Warm start on simulated drives: what saved evidence is worth, and whether a moved sensor shows.

    python -m benchmarks.warm_start [--seeds 20] [--first 20] [--minutes 12] [--from 0]

Each vehicle drives twice on different roads. Its state of the first drive is saved and serves in
the second, with the evidence in it and without; before the second drive load and springs turn the
body by a random amount (`BETWEEN_DRIVES_STD`). In some cases somebody moves the sensor as well,
about a random axis, before the drive or in it (`TURNED_AT_S`). Told are when the mount was
confirmed, when its yaw was as certain as before the restart again, when it was called suspect,
rightly or wrongly, and errors on the way.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from imucald.core.rotations import rotation_from_vector, vector_from_rotation
from imucald.motion.column_ticks import ticks_from_samples
from imucald.mount.estimate import BETWEEN_DRIVES_STD, MountEstimator, MountState
from imucald.mount.restored import Phase, RestoredEstimator, StoredMount
from imucald.mount.saved_information import SavesInformation, saved_from
from imucald.runtime.estimators import estimator_for
from imucald.runtime.session import open_config
from imucald.simulation import Drive, VehicleModel, random_model, simulate

CONFIG = Path(__file__).parent.parent / "config" / "examples" / "passenger_car.yaml"
MOVED_DEG = (0.0, 2.0, 5.0, 8.0)
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
    found = estimator.estimate()
    assert isinstance(estimator, SavesInformation)
    kept = estimator.saved_information()
    R, covariance = found.R_vehicle_from_sensor, found.covariance
    if found.state not in GOOD or R is None or covariance is None or kept is None:
        return None
    return StoredMount(R, covariance, found.state, evidence=saved_from(kept.plain()))


def moved(stored: StoredMount, turn: NDArray[np.float64]) -> StoredMount:
    """The same as if the sensor had been turned by -turn [rad] since, about vehicle axes."""
    R = rotation_from_vector(turn)
    kept = stored.evidence
    assert kept is not None
    return replace(
        stored,
        R_vehicle_from_sensor=R @ stored.R_vehicle_from_sensor,
        evidence=replace(kept, R=R @ kept.R),
    )


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
            now = np.array(estimator.correction).reshape(3, 3)
            errors.append(np.degrees(vector_from_rotation(truth @ now.T)))
            stds.append(np.degrees(std))
    return Course(confirmed, precise, doubted, np.array(errors), np.array(stds))


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--from", type=int, default=0, dest="start", metavar="SEED")
    parser.add_argument("--first", type=float, default=20.0, metavar="MIN")
    parser.add_argument("--minutes", type=float, default=12.0)
    options = parser.parse_args()
    config = open_config(CONFIG).config
    found: dict[tuple[float, bool], list[Course]] = {
        (degrees, kept): [] for degrees in (*MOVED_DEG, WHILE_DRIVING) for kept in (False, True)
    }
    for seed in range(options.start, options.start + options.seeds):
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
                then = moved(stored, load + parked * axis)
                if not kept:
                    then = replace(then, evidence=None)
                begin = TURNED_AT_S if degrees == WHILE_DRIVING else 0.0
                restored = RestoredEstimator(estimator_for(config), then)
                courses.append(course(restored, rows, truth, begin))
    for (degrees, kept), courses in found.items():
        what = f"moved {degrees:g} deg" if degrees != WHILE_DRIVING else TURNED
        looks = range(len(LOOKS_S)) if degrees == 0.0 else [len(LOOKS_S) - 1]
        print(f"{what}, evidence {'kept' if kept else 'left'}: {told(courses, looks)}")
    return 0


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
