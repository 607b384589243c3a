"""Turns the mount in a model file."""

from __future__ import annotations

import math
from collections.abc import Sequence

from imucald.frames import angles_from_rotation, rotation_from_angles, rotation_from_vector
from imucald.simulation.model import Model


def turned_mount(model: Model, rotation_vector: Sequence[float]) -> Model:
    """Return the model with its mount turned by a vector (3,) about vehicle axes [rad]."""
    mount = model.mount
    R_vehicle_from_sensor = rotation_from_vector(rotation_vector) @ rotation_from_angles(
        math.radians(mount.roll_deg), math.radians(mount.pitch_deg), math.radians(mount.yaw_deg)
    )
    roll, pitch, yaw = (math.degrees(x) for x in angles_from_rotation(R_vehicle_from_sensor))
    return model.with_changes(
        {"mount.roll_deg": roll, "mount.pitch_deg": pitch, "mount.yaw_deg": yaw}
    )
