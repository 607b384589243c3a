"""The sensor does not sit as the model file says."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imucald.core.rotations import rotation_from_vector
from imucald.diagnosis.cause import Cause, Parameter, Values
from imucald.diagnosis.forward_mount import turned_mount
from imucald.diagnosis.result import Estimated
from imucald.diagnosis.state import State
from imucald.model.model import VehicleModel

KEYS = ("_mount.x", "_mount.y", "_mount.z")
DEG = 0.017453292519943295


class MountRotation(Cause):
    """R_vehicle_from_sensor = exp(rotation vector) * the model's; vector about vehicle axes."""

    name = "mount_rotation"
    parameters = tuple(Parameter(key, "rad", 0.2 * DEG, 4.0 * DEG, 0.2 * DEG) for key in KEYS)
    signals = ("accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z")
    seen_by = "accelerate and brake in a straight line, and corner both ways"
    sentence = "The sensor is turned against the mount in the model file."

    def mount(self, s: State, p: Values) -> None:
        """Turn the sensor."""
        vector = [p[key] for key in KEYS]
        if any(vector):
            s.turns.append((-math.inf, rotation_from_vector(np.negative(vector))))

    def extend(self, model: VehicleModel, p: Values, keys: Sequence[str]) -> VehicleModel:
        """Return the model with the mount turned."""
        return turned_mount(model, [p[key] for key in KEYS])

    def report(self, p: Values, std: Values, keys: Sequence[str]) -> dict[str, Estimated]:
        """Return the rotation vector from the model's mount, about vehicle axes, in degrees."""
        return {
            f"mount.{name}_deg": Estimated(p[key] / DEG, std[key] / DEG, "deg")
            for name, key in zip(("roll", "pitch", "yaw"), KEYS, strict=True)
        }
