"""A drive's samples through the daemon's pipeline, with and without a model: what it is worth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucald.compensation.compensation import Compensation
from imucald.compensation.vehicle import Corrected
from imucald.motion.ticks import TICK_RATE
from imucald.mount.estimate import MountEstimate
from imucald.mount.estimator import FullEstimator
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.out_parts import rotated_columns
from imucald.pipeline import Pipeline, Snapshot
from imucald.samples import Samples, Series

TRIADS = ("accel", "gyro")


@dataclass(frozen=True)
class CorrectedDrive:
    """What the daemon makes of a drive.

    estimate: of the mount, at the end. snapshots: one a second. accel, gyro: corrected samples
    (N, 3), SI, as they would have been sent: in vehicle axes (the road's where leaning is taken
    out), NaN while the mount was not known. A channel that the drive lacks is None.
    """

    estimate: MountEstimate
    snapshots: tuple[Snapshot, ...]
    accel: Series | None
    gyro: Series | None


def corrected_drive(
    samples: Samples,
    compensation: Compensation | None,
    settings: EstimatorSettings | None = None,
    R_vehicle_from_sensor: NDArray[np.float64] | None = None,
) -> CorrectedDrive:
    """Run samples through sensor terms, estimator and correction, as `run` and `replay` do.

    settings: of the estimator, as they are without a model. R_vehicle_from_sensor: (3, 3) to
    correct with instead of the estimate, which shows the signals' own error.
    """
    settings = settings or EstimatorSettings()
    channels = frozenset(samples)
    if compensation is not None:
        samples = compensation.samples(samples)
        settings = compensation.full_settings(settings)
    evidence = None if compensation is None else compensation.evidence_stage()
    pipeline = Pipeline(FullEstimator(settings), evidence=evidence)
    t_last = max((float(s.t[-1]) for s in samples.values() if len(s.t)), default=0.0)
    corrections, snapshots = pipeline.run(samples, {}, t_last)
    turned: dict[str, Corrected] = {}
    for channel in TRIADS:
        if channel in samples:
            series = samples[channel]
            index = np.floor(series.t * TICK_RATE).astype(np.int64) - corrections.first
            rotations = corrections.rotations[index]
            if R_vehicle_from_sensor is not None:
                rotations = np.tile(R_vehicle_from_sensor.ravel(), (len(series.t), 1))
            values = rotated_columns(rotations, series.values)
            turned[channel] = Corrected(series.t, series.t, values)
    if compensation is not None:
        columns = compensation.vehicle_stage(channels).columns(turned)
    else:
        columns = {channel: one.values for channel, one in turned.items()}
    out = {channel: Series(turned[channel].t, values) for channel, values in columns.items()}
    return CorrectedDrive(
        pipeline.estimator.estimate(), tuple(snapshots), out.get("accel"), out.get("gyro")
    )
