"""One drive diagnosed: what was said beside what is true, as a plain mapping."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.diagnosis.cases import Case
from hidden import HiddenDrive, hidden_drive
from imucald.compensation import compensation_from_model
from imucald.compensation.trial import corrected_drive
from imucald.config.vehicle import VehicleSettings
from imucald.core.rotations import vector_from_rotation
from imucald.diagnosis.diagnose import diagnose
from imucald.diagnosis.result import Diagnosis, FoundCause
from imucald.model.model import VehicleModel, model_from_mapping
from imucald.mount.estimator_settings import EstimatorSettings

Array = NDArray[np.float64]

VECTOR_ANGLES = ("roll", "pitch", "yaw")
MOVING_MPS = 1.0
SLOW_S = 1.0
"""Corrected forces are compared as means over such a time."""


def outcome(case: Case) -> dict[str, Any]:
    """Diagnose one hidden drive, and what it gives the vehicle where the case asks for it."""
    drive = hidden_drive(case.seed, case.effects, case.minutes)
    baseline = model_from_mapping(dict(drive.model), "baseline")
    began = time.process_time()
    diagnosis = diagnose([drive.samples], baseline)
    seconds = time.process_time() - began
    said = diagnosis.as_json()
    for name in ("candidates", "notes"):
        said.pop(name, None)
    result: dict[str, Any] = {
        "key": case.key,
        "part": case.part,
        "seed": case.seed,
        "minutes": case.minutes,
        "hidden": [[e.cause, e.size] for e in case.effects],
        "cpu_s": round(seconds, 2),
        "said": said,
        "truth": {name: dict(values) for name, values in drive.truth.items()},
        "scores": [score for cause in diagnosis.causes for score in scored(cause, drive)],
    }
    if case.with_gain:
        result["vehicle"] = vehicle_gain(drive, baseline, diagnosis)
        if case.effects:
            twin = hidden_drive(case.seed, (), case.minutes)
            result["vehicle"]["without"] = daemon(twin, baseline.dump())
    return result


def scored(cause: FoundCause, drive: HiddenDrive) -> list[dict[str, Any]]:
    """Each parameter of a named cause beside its true value."""
    found = []
    stated = _stated(drive.model)
    for name, estimate in cause.parameters.items():
        key, factor = _true_key(cause.name, name, estimate.unit)
        true = drive.parameters.get(key)
        if true is None:
            continue
        base = 0.0 if "rotation_deg" in key else stated.get(key, 0.0)
        found.append(
            {
                "cause": cause.name,
                "name": name,
                "value": estimate.value * factor,
                "std": estimate.std * factor,
                "true": true,
                "base": base,
            }
        )
    return found


def _true_key(cause: str, name: str, unit: str) -> tuple[str, float]:
    """The generator's name of a parameter, and the factor to its unit."""
    if cause in {"mount_rotation", "mount_shift"}:
        parent, _, last = name.rpartition(".")
        axis = last.removesuffix("_deg")
        factor = math.degrees(1.0) if unit == "rad" else 1.0
        if axis in VECTOR_ANGLES:
            return f"{parent}.rotation_deg.{VECTOR_ANGLES.index(axis)}", factor
    return name, math.radians(1.0) if unit.startswith("deg") and "deg" not in name else 1.0


def _stated(model: Mapping[str, Any]) -> dict[str, float]:
    """Numbers of the baseline by dotted key, with indices."""
    full = model_from_mapping(dict(model), "baseline").dump()
    found: dict[str, float] = {}

    def walk(key: str, value: Any) -> None:
        if isinstance(value, dict):
            for name, part in value.items():
                walk(f"{key}.{name}" if key else name, part)
        elif isinstance(value, list | tuple):
            for i, part in enumerate(value):
                walk(f"{key}.{i}", part)
        elif isinstance(value, int | float):
            found[key] = float(value)

    walk("", full)
    return found


# what it is worth to the vehicle ---------------------------------------------------------------


def vehicle_gain(
    drive: HiddenDrive, baseline: VehicleModel, diagnosis: Diagnosis
) -> dict[str, Any]:
    """Mount angle and corrected force of the daemon: no model, the baseline, the extended model.

    What an effect does to the mount shows beside the same drive without it, which is added there.
    """
    models: dict[str, VehicleModel | None] = {
        "none": None,
        "before": baseline,
        "after": diagnosis.model_after,
    }
    return {
        name: daemon(drive, None if model is None else model.dump())
        for name, model in models.items()
    }


KEEPS_RIGHT = EstimatorSettings(vehicle=VehicleSettings(driving_side="right"))
"""The hidden drives keep to the right."""


def daemon(drive: HiddenDrive, model: Mapping[str, Any] | None) -> dict[str, Any]:
    """Errors of the daemon's mount at the end, and of its corrected acceleration all along."""
    compensation = None if model is None else compensation_from_model(model)
    done = corrected_drive(drive.samples, compensation, KEEPS_RIGHT)
    R = done.estimate.R_vehicle_from_sensor
    std = done.estimate.std
    if R is None or std is None:
        return {"mount_deg": None, "std_deg": None, "force": None}
    error = np.degrees(vector_from_rotation(R @ drive.R_vehicle_from_sensor.T))
    return {
        "mount_deg": [round(float(x), 4) for x in error],
        "std_deg": [round(math.degrees(x), 4) for x in std],
        "force": _force_error(drive, done.accel.t, done.accel.values) if done.accel else None,
    }


def _force_error(drive: HiddenDrive, t: Array, accel: Array) -> list[float] | None:
    """rms error of the corrected force on each axis [m/s^2], of slow means while driving.

    Beside the force at the vehicle's reference in road axes: what a level, rigid vehicle feels.
    """
    good = np.isfinite(accel).all(axis=1)
    # The sample's age is taken off: a late frame is not a wrong one.
    when = t[good] - drive.parameters["accel.delay_s"]
    if len(when) < 1000:
        return None
    grid = np.arange(max(when[0], 0.0) + SLOW_S, when[-1] - SLOW_S, 0.5 * SLOW_S)
    moving = np.interp(grid, drive.t, np.abs(drive.speed)) > MOVING_MPS
    errors = []
    for i in range(3):
        measured = _means(when, accel[good, i], grid)
        true = _means(drive.t, drive.road_force[:, i], grid)
        errors.append(round(float(np.sqrt(np.nanmean((measured - true)[moving] ** 2))), 5))
    return errors


def _means(t: Array, x: Array, grid: Array) -> Array:
    """Mean of x over SLOW_S about each time of the grid; NaN where there is nothing."""
    total = np.concatenate([[0.0], np.cumsum(x)])
    low = np.searchsorted(t, grid - 0.5 * SLOW_S)
    high = np.searchsorted(t, grid + 0.5 * SLOW_S)
    count = high - low
    mean: Array = np.where(count > 0, (total[high] - total[low]) / np.maximum(count, 1), np.nan)
    return mean
