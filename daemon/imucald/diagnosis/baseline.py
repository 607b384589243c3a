"""The model file that a diagnosis starts from if the user gives none.

The model file describes an ordinary car. The file contains the defaults of the simulation, the
vehicle data of the configuration, the sample rates of the logs, and the mount that the daemon's own
estimator finds in the logs. A value that nobody has stated may have any plausible value
(`known_to`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from imucald.config import LoadedConfig
from imucald.core.arrays import Array
from imucald.core.errors import EstimateError
from imucald.core.samples import INERTIAL, Samples
from imucald.diagnosis.cause_keys import plausible
from imucald.diagnosis.direct.faults import PAUSE_S, clock_of
from imucald.diagnosis.recording import Recording
from imucald.diagnosis.signals import SIGNALS
from imucald.model.model import VehicleModel
from imucald.mount.estimate import MountEstimate
from imucald.mount.mount_words import reasons_line
from imucald.runtime.estimators import estimator_for
from imucald.runtime.pipeline import Pipeline

NOT_STATED = (
    "mount.lever_arm_m.0", "mount.lever_arm_m.1", "mount.lever_arm_m.2",
    "suspension.squat_gradient", "suspension.dive_gradient", "suspension.roll_gradient",
)  # fmt: skip
"""Values of the vehicle that no configuration states. The drives show these values. The steering
ratio and the understeer are not in this list: if both are fitted together, the errors are 6 % and
0.003 rad/(m/s^2)."""
LARGEST_STD_DEG = 4.0
"""Largest standard deviation of the mount [deg] at which a comparison is possible."""


def baseline_model(loaded: LoadedConfig, recordings: Sequence[Recording]) -> VehicleModel:
    """Return a model for a configured vehicle and its drives.

    Raises EstimateError if the mount cannot be found from the drives.
    """
    vehicle = loaded.config.vehicle
    side = "left" if vehicle.driving_side == "left" else "right"
    changes: dict[str, Any] = {
        "route.driving_side": side,
        "chassis.wheelbase_m": vehicle.wheelbase,
        "chassis.cg_to_front_m": 0.45 * vehicle.wheelbase,
        "chassis.steering_ratio": vehicle.steering_ratio,
        **_mount(loaded, [recording.samples for recording in recordings]),
    }
    for name, hz in _rates(recordings).items():
        changes[f"{name}.rate_hz"] = hz
        if name in INERTIAL:
            changes[f"{name}.lowpass_hz"] = None
    changes["grid_hz"] = max(200.0, *(changes.get(f"{n}.rate_hz", 0.0) for n in ("accel", "gyro")))
    model = VehicleModel().with_changes(changes)
    known_to = {key: max(map(abs, plausible(model, key))) for key in NOT_STATED}
    return model.with_changes({"known_to": known_to})


def _rates(recordings: Sequence[Recording]) -> Mapping[str, float]:
    """Return the nominal sample rates [Hz], from the database's cycle times or else from the time
    stamps."""
    rates: dict[str, float] = {}
    for recording in recordings:
        for name in (*SIGNALS, "temperature"):
            if name in rates or name not in recording.samples:
                continue
            t = recording.samples[name].t
            if len(t) < 2:
                continue
            cycle = recording.cycle_s.get(name) or _cycle(t)
            rates[name] = max(1.0 / max(cycle, 1e-3), 0.2)
    return rates


def _cycle(t: Array) -> float:
    """Return the cycle time of frames at times t (N,) [s], or the mean step.
    The median is not used because most steps within batches are much shorter."""
    clock = clock_of(t)
    if clock is not None:
        return clock.cycle_s
    steps = np.diff(t)
    return float(np.mean(steps[steps < PAUSE_S])) if (steps < PAUSE_S).any() else PAUSE_S


def _mount(loaded: LoadedConfig, drives: Sequence[Samples]) -> dict[str, float]:
    """Return the mount angles [deg] by the daemon's estimator, which takes the drives one after
    another.

    A model file has only the rotation of the housing. The diagnosis finds the errors of the axes
    separately. The mount may be unknown at the end of the drives, for example because the sensor
    swayed and the search started again. In this case, the most certain estimate of the drives is
    used.
    """
    pipeline = Pipeline(estimator_for(loaded.config))
    start = 0.0
    surest: MountEstimate | None = None
    for samples in drives:
        last = max(float(s.t[-1]) for s in samples.values() if len(s.t))
        moved = {name: type(s)(s.t + start, s.values) for name, s in samples.items()}
        _, snapshots = pipeline.run(moved, {}, start + last)
        known = [s.estimate for s in snapshots if _is_known(s.estimate)]
        surest = min(filter(None, [surest, *known]), key=_uncertainty, default=None)
        start = math.ceil(start + last + 1.0)
        pipeline.gap(int(start * 10))
    final = pipeline.estimator.estimate()
    best = final if _is_known(final) else surest
    if best is None or best.angles is None:
        why = reasons_line(final.waiting_for)
        raise EstimateError(
            "the drives do not show the mount, so there is no model to compare with; give "
            f"one with --model ({why or 'see imucald replay'})"
        )
    roll, pitch, yaw = (math.degrees(angle) for angle in best.angles)
    return {"mount.roll_deg": roll, "mount.pitch_deg": pitch, "mount.yaw_deg": yaw}


def _is_known(estimate: MountEstimate) -> bool:
    return estimate.angles is not None and _uncertainty(estimate) <= LARGEST_STD_DEG


def _uncertainty(estimate: MountEstimate) -> float:
    """Return the largest standard deviation of the mount's angles [deg]."""
    return math.inf if estimate.std is None else math.degrees(max(estimate.std))
