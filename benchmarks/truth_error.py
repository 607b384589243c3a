"""What is wrong with corrected signals, where the truth is known: simulated drives only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from benchmarks.corrected_drive import CorrectedDrive
from imucald.core.rotations import vector_from_rotation
from imucald.core.samples import Series
from imucald.model_compensation.vehicle import less_suspension_rate, on_road

if TYPE_CHECKING:
    from imucald.simulation import Truth

Array = NDArray[np.float64]

MEAN_S = 0.5
"""Errors are of means over this time [s]: what a vehicle does, less what shakes it."""
MOVING_MPS = 1.0


@dataclass(frozen=True)
class DriveErrors:
    """Errors while moving, rms over the drive.

    accel: forward, left, up [m/s^2]. gyro: about them [deg/s]. mount: rotation-vector error about
    them at the end [deg]. usable: part of the time moving in which there was a correction.
    """

    accel: Array
    gyro: Array
    mount: Array
    usable: float


def drive_errors(
    drive: CorrectedDrive, truth: Truth, on_the_road: bool = True, from_s: float = 0.0
) -> DriveErrors:
    """Hold corrected signals against the truth at the body's centre of rotation.

    on_the_road: in axes of the road under the vehicle, else of the body. from_s: what comes before
    is left out [s].
    """
    force, rate = true_signals(truth, on_the_road)
    nothing = np.full(3, np.nan)
    accel, usable = nothing, 0.0
    if drive.accel is not None:
        accel, usable = _rms(drive.accel, truth, force, from_s)
    gyro = nothing
    if drive.gyro is not None:
        gyro = np.degrees(_rms(drive.gyro, truth, rate, from_s)[0])
    R = None if drive.estimate is None else drive.estimate.R_vehicle_from_sensor
    mount = nothing
    if R is not None:
        mount = np.degrees(vector_from_rotation(truth.R_vehicle_from_sensor() @ R.T))
    return DriveErrors(accel, gyro, mount, usable)


def true_signals(truth: Truth, on_the_road: bool) -> tuple[Array, Array]:
    """Specific force [m/s^2] and angular rate [rad/s] (N, 3) on the truth's times."""
    if not on_the_road:
        return truth.reference_force, truth.rate
    roll, pitch = truth.body_roll, truth.body_pitch
    lean = (roll, pitch, np.gradient(roll, truth.t), np.gradient(pitch, truth.t))
    force = on_road(lean, *truth.reference_force.T)
    rate = on_road(lean, *less_suspension_rate(lean, *truth.rate.T))
    return np.stack(force, axis=1), np.stack(rate, axis=1)


def _rms(series: Series, truth: Truth, true: Array, from_s: float) -> tuple[Array, float]:
    t = series.t
    wrong = series.values - np.stack([np.interp(t, truth.t, x) for x in true.T], axis=1)
    n = max(1, round(MEAN_S * (len(t) - 1) / max(float(t[-1] - t[0]), 1e-9)))
    kernel = np.ones(n) / n
    smooth = np.stack([np.convolve(x, kernel, "same") for x in wrong.T], axis=1)
    moving = (np.interp(t, truth.t, np.abs(truth.speed)) > MOVING_MPS) & (t >= from_s)
    known = moving & np.isfinite(smooth).all(axis=1)
    if not known.any():
        return np.full(3, np.nan), 0.0
    share = float(known.sum() / moving.sum())
    return np.sqrt((smooth[known] ** 2).mean(axis=0)), share
