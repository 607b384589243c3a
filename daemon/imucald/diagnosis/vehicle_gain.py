"""What the extension is worth to the vehicle: the daemon's own mount, without it and with it.

Where the truth is not known, the mount of the extended model stands for it: the diagnosis knows
it from all signals together, the daemon's estimator from what a drive gives it on the way.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imucald.compensation import compensation_from_model
from imucald.compensation.trial import corrected_drive
from imucald.config.vehicle import VehicleSettings
from imucald.core.rotations import Matrix3, rotation_from_angles, vector_from_rotation
from imucald.core.samples import Samples
from imucald.diagnosis.forward_mount import mount_of
from imucald.model.model import VehicleModel
from imucald.mount.estimator_settings import EstimatorSettings


def mount_errors_deg(
    drives: Sequence[Samples], before: VehicleModel, after: VehicleModel
) -> tuple[float | None, float | None]:
    """Angle between the daemon's mount at the end of the drives and the extended model's [deg].

    First with the model file as it was, then with the extended one; root mean square over the
    drives, None where the daemon has no estimate.
    """
    final = _final_mount(after)
    return _error(drives, before, final), _error(drives, after, final)


def _final_mount(model: VehicleModel) -> Matrix3:
    R_vehicle_from_sensor = mount_of(model)
    for shift in model.mount.shifts:
        angles = (math.radians(x) for x in (shift.roll_deg, shift.pitch_deg, shift.yaw_deg))
        R_vehicle_from_sensor = rotation_from_angles(*angles) @ R_vehicle_from_sensor
    return R_vehicle_from_sensor


KEEPS_RIGHT = EstimatorSettings(vehicle=VehicleSettings(driving_side="right"))
"""As before the settings moved: the gain is that of a vehicle that keeps to the right."""


def _error(drives: Sequence[Samples], model: VehicleModel, final: Matrix3) -> float | None:
    compensation = compensation_from_model(model.dump())
    squares = []
    for samples in drives:
        estimate = corrected_drive(samples, compensation, KEEPS_RIGHT).estimate
        R = None if estimate is None else estimate.R_vehicle_from_sensor
        if R is not None:
            squares.append(float(np.sum(vector_from_rotation(R @ final.T) ** 2)))
    return math.degrees(math.sqrt(float(np.mean(squares)))) if squares else None
