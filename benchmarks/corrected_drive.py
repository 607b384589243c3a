"""A drive's samples through the daemon's pipeline, with and without a model: what it is worth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucald.core.rotations import times_columns
from imucald.core.samples import Samples, Series
from imucald.model_compensation.compensation import ModelCompensation
from imucald.model_compensation.lever_arm_and_suspension import Corrected
from imucald.motion.ticks import TICK_RATE
from imucald.mount.estimate import MountEstimate
from imucald.mount.estimator import JointEstimator
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.runtime.pipeline import Pipeline, Snapshot

Array = NDArray[np.float64]

TRIADS = ("accel", "gyro")


@dataclass(frozen=True)
class CorrectedDrive:
    """What the daemon makes of a drive.

    accel, gyro: corrected samples (N, 3), SI, as they would have been sent: in vehicle axes (the
    road's where the suspension is taken out), NaN while the mount was not known. A channel that the
    drive lacks is None. estimate: of the mount, at the end; None where the mount was given.
    snapshots: one a second.
    """

    accel: Series | None
    gyro: Series | None
    estimate: MountEstimate | None = None
    snapshots: tuple[Snapshot, ...] = ()


def corrected_drive(
    samples: Samples,
    compensation: ModelCompensation | None,
    settings: EstimatorSettings | None = None,
) -> CorrectedDrive:
    """Run samples through sensor terms, estimator and correction, as `run` and `replay` do.

    settings: of the estimator, as they are without a model.
    """
    settings = settings or EstimatorSettings()
    channels = frozenset(samples)
    ticks = None
    if compensation is not None:
        samples = compensation.samples(samples)
        settings = compensation.joint_settings(settings)
        ticks = compensation.tick_preprocessing()
    pipeline = Pipeline(JointEstimator(settings), preprocessor=ticks)
    t_last = max((float(s.t[-1]) for s in samples.values() if len(s.t)), default=0.0)
    corrections, snapshots = pipeline.run(samples, {}, t_last)

    def turned(channel: str, series: Series) -> Array:
        index = np.floor(series.t * TICK_RATE).astype(np.int64) - corrections.first
        return corrections.turned(channel, index, series.values)

    accel, gyro = _corrected(samples, channels, compensation, turned)
    return CorrectedDrive(accel, gyro, pipeline.estimator.estimate(), tuple(snapshots))


def corrected_with(
    samples: Samples, compensation: ModelCompensation | None, R_vehicle_from_sensor: Array
) -> CorrectedDrive:
    """The same with a mount (3, 3) that is given: what is wrong then is the signals' own error."""
    channels = frozenset(samples)
    if compensation is not None:
        samples = compensation.samples(samples)
    nine = R_vehicle_from_sensor.reshape(1, 9)

    def turned(channel: str, series: Series) -> Array:
        return times_columns(nine, series.values)

    return CorrectedDrive(*_corrected(samples, channels, compensation, turned))


def _corrected(
    samples: Samples,
    channels: frozenset[str],
    compensation: ModelCompensation | None,
    applied: Callable[[str, Series], Array],
) -> tuple[Series | None, Series | None]:
    """Corrected accelerometer and gyroscope; applied: gives a channel's samples (N, 3) so far."""
    turned = {
        channel: Corrected(series.t, series.t, applied(channel, series))
        for channel, series in samples.items()
        if channel in TRIADS
    }
    columns = {channel: one.values for channel, one in turned.items()}
    if compensation is not None:
        columns = compensation.vehicle_correction(channels).columns(turned)
    found = {channel: Series(turned[channel].t, values) for channel, values in columns.items()}
    return found.get("accel"), found.get("gyro")
