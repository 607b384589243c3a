"""Simulated drives as ticks, and what an estimator says of them at given times."""

from __future__ import annotations

import hashlib
import math
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.integrity.force import Response, left_over, stated
from imucald.config.calibration import CalibrationSettings
from imucald.config.vehicle import VehicleSettings
from imucald.core.rotations import Matrix3, rotation_from_vector, vector_from_rotation
from imucald.motion import ticks as tk
from imucald.motion.column_ticks import ticks_from_samples
from imucald.mount.estimate import MountEstimator, MountState
from imucald.mount.estimator import JointEstimator
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.method_a.estimator import PublishedEstimator
from imucald.mount.method_a.settings import PublishedSettings
from imucald.simulation import random_model, simulate
from imucald.simulation.imu import gain_matrix

Array = NDArray[np.float64]

KEEP = "IMUCALD_KEEP_DRIVES"
"""Environment: a folder where simulated ticks are kept, for runs over the same seeds."""
MOVING = 0.3
"""Driving is counted above this speed [m/s]."""
BAD_STATES = frozenset({MountState.SUSPECT, MountState.RECALIBRATING})


@dataclass(frozen=True)
class Drive:
    """Ticks of a drive and its truth."""

    seed: int
    rows: Array
    R_vehicle_from_sensor: Matrix3
    crown: float  # mean roll of the roads driven [rad]
    response: Response = field(default_factory=Response)


def drive(
    seed: int, minutes: float, changes: Mapping[str, Any] | None = None, **drawn: Any
) -> Drive:
    """A drive whose nuisances are all drawn from the seed, with some of them then changed."""
    model = random_model(seed, **drawn)
    if changes:
        model = model.with_changes(changes)
    response = Response(
        gain_matrix(model.accel), gain_matrix(model.gyro), np.array(model.accel.bias)
    )
    kept = _kept_at(f"{seed} {minutes} {changes} {drawn}")
    if kept is not None and kept.exists():
        with np.load(kept) as found:
            return Drive(seed, found["rows"], found["R"], float(found["crown"]), response)
    made = simulate(model, seed, minutes)
    rows = ticks_from_samples(made.samples, 0, int(minutes * 600))
    R, crown = made.truth.R_vehicle_from_sensor(), made.truth.mean_crown()
    if kept is not None:
        making = kept.with_suffix(".making.npz")
        np.savez(making, rows=rows, R=R, crown=crown)
        making.rename(kept)
    return Drive(seed, rows, R, crown, response)


def _kept_at(recipe: str) -> Path | None:
    folder = os.environ.get(KEEP)
    if not folder:
        return None
    digest = hashlib.sha256(recipe.encode()).hexdigest()[:16]
    return Path(folder) / f"drive-{digest}.npz"


@dataclass
class Said:
    """What was said at a time: errors and standard deviations about x, y, z [deg].

    beyond_crown: the error about x when the drive's mean crown is taken as known [deg].
    left, left_std: (8,) what the correction that was found leaves in a consumer's samples, and its
    stated deviations (`integrity.force.ENTRIES`).
    """

    error: Array
    std: Array
    beyond_crown: float
    shares: Mapping[str, Mapping[str, float]]
    left: Array
    left_std: Array


KEEPS_RIGHT = VehicleSettings(driving_side="right")
FULL = EstimatorSettings(vehicle=KEEPS_RIGHT)
"""The joint estimator knows on which side traffic keeps, as the configuration would say."""
METHOD_A = PublishedSettings(
    CalibrationSettings(accelerometer_bias=0.098),
    VehicleSettings(crown_percent=0.0, crown_spread_percent=1.34),
)
"""Method A does not: the crown is noise to it."""


@dataclass
class Trace:
    """A run over a drive: what was said at the asked times, and when it became usable."""

    said: dict[float, Said] = field(default_factory=dict)
    usable_after: float = math.nan  # seconds of driving
    manoeuvres_after: float = math.nan  # seconds of driving until three launches or brakings
    bad_at: list[float] = field(default_factory=list)  # stream time of each shift reported
    microseconds: float = math.nan  # processor time per tick


def estimators(cross_axis: float = 0.0) -> dict[str, MountEstimator]:
    """All estimators, new."""
    settings = EstimatorSettings(CalibrationSettings(cross_axis=cross_axis), KEEPS_RIGHT)
    return {
        "joint": usual_estimator(settings),
        "published": PublishedEstimator(METHOD_A),
    }


def usual_estimator(settings: EstimatorSettings) -> JointEstimator:
    """The one that a configuration has where it names none."""
    return JointEstimator(settings)


def run(estimator: MountEstimator, made: Drive, minutes: Sequence[float]) -> Trace:
    """Run an estimator over a drive; asks it at the given times [min]."""
    trace = Trace()
    asked = {int(m * 600): m for m in minutes}
    moving = _driving(made.rows)
    hard = _manoeuvres(made.rows)
    if (hard >= 3).any():
        trace.manoeuvres_after = float(moving[int(np.argmax(hard >= 3))])
    before, usable = MountState.WAITING, False
    rows = made.rows.tolist()
    began = time.process_time()
    for k, row in enumerate(rows, start=1):
        estimator.step(row)
        state = estimator.state
        if state is not before:
            if state == MountState.SUSPECT and before not in BAD_STATES:
                trace.bad_at.append(row[tk.T])
            if not usable and state in {MountState.USABLE, MountState.FINE}:
                usable, trace.usable_after = True, float(moving[k - 1])
            before = state
        if k in asked:
            said = _said(estimator, made)
            if said is not None:
                trace.said[asked[k]] = said
    trace.microseconds = (time.process_time() - began) / len(rows) * 1e6
    return trace


def driven(made: Drive, start: float, stop: float) -> float:
    """Seconds of driving between two times [s]."""
    t = made.rows[:, tk.T]
    return float(np.diff(np.interp([start, stop], t, _driving(made.rows)))[0])


def _driving(rows: Array) -> Array:
    """Seconds of driving so far (N,)."""
    return np.asarray(np.cumsum(np.abs(np.nan_to_num(rows[:, tk.SPEED.mean])) > MOVING) * 0.1)


def _manoeuvres(rows: Array) -> Array:
    """Launches and brakings above 1 m/s^2 for half a second, counted (N,)."""
    speed = np.nan_to_num(rows[:, tk.SPEED.mean])
    change = (speed[5:] - speed[:-5]) / 0.5
    hard = np.abs(change) > 1.0
    starts = hard & ~np.roll(hard, 1)
    return np.concatenate([np.zeros(5), np.cumsum(starts)])


def _said(estimator: MountEstimator, made: Drive) -> Said | None:
    estimate = estimator.estimate()
    R, std = estimate.R_vehicle_from_sensor, estimate.std
    if R is None or std is None:
        return None
    error = np.degrees(vector_from_rotation(made.R_vehicle_from_sensor @ R.T))
    expected = KEEPS_RIGHT.crown_mean if isinstance(estimator, JointEstimator) else 0.0
    turned = rotation_from_vector([made.crown - expected, 0.0, 0.0]) @ made.R_vehicle_from_sensor
    beyond = float(np.degrees(vector_from_rotation(turned @ R.T))[0])
    shares = estimate.details.get("evidence_share", {})
    applied, sent = estimate.correction, estimate.sent
    assert applied is not None
    assert sent is not None
    return Said(
        error,
        np.degrees(np.array(std)),
        beyond,
        shares if isinstance(shares, dict) else {},
        left_over(applied, made.response, made.R_vehicle_from_sensor, turned),
        stated(sent),
    )
