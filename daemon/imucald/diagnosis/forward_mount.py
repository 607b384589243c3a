"""The mount in a model file: as a rotation, and turned."""

from __future__ import annotations

import math
from collections.abc import Sequence

from imucald.core.rotations import (
    Matrix3,
    angles_from_rotation,
    rotation_from_angles,
    rotation_from_vector,
)
from imucald.model.model import VehicleModel


def mount_of(model: VehicleModel) -> Matrix3:
    """Return R_vehicle_from_sensor of a model file, at the start of the drive."""
    mount = model.mount
    return rotation_from_angles(
        math.radians(mount.roll_deg), math.radians(mount.pitch_deg), math.radians(mount.yaw_deg)
    )


def turned_mount(model: VehicleModel, rotation_vector: Sequence[float]) -> VehicleModel:
    """Return the model with its mount turned by a vector (3,) about vehicle axes [rad]."""
    R_vehicle_from_sensor = rotation_from_vector(rotation_vector) @ mount_of(model)
    roll, pitch, yaw = (math.degrees(x) for x in angles_from_rotation(R_vehicle_from_sensor))
    return model.with_changes(
        {"mount.roll_deg": roll, "mount.pitch_deg": pitch, "mount.yaw_deg": yaw}
    )
