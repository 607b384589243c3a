"""The sensor is turned in mid-drive."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imucald.core.rotations import rotation_from_vector
from imucald.diagnosis.cause import Cause, Parameter, Values
from imucald.diagnosis.result import Estimated
from imucald.diagnosis.state import State
from imucald.model.model import VehicleModel

KEYS = ("_shift.x", "_shift.y", "_shift.z")
TIME = "_shift.t"
"""Time of the shift [s]; searched, not fitted."""
ANGLES = ("roll", "pitch", "yaw")
TIME_STD_S = 12.0
"""Stretches are half a minute apart; their residuals narrow it down to this."""
DEG = 0.017453292519943295


class MountShift(Cause):
    """From a time on, R_vehicle_from_sensor = exp(rotation vector) * what it was."""

    name = "mount_shift"
    parameters = (*(Parameter(key, "rad", 0.01 * DEG, 4.0 * DEG, 0.2 * DEG) for key in KEYS),)
    signals = ("accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z")
    seen_by = "drive on for ten minutes with stops, brakings and turns both ways"
    sentence = "The sensor was turned during the drive."

    def mount(self, s: State, p: Values) -> None:
        """Turn the sensor from the time on."""
        vector = [p[key] for key in KEYS]
        if any(vector):
            s.turns.append((p[TIME], rotation_from_vector(np.negative(vector))))

    def extend(self, model: VehicleModel, p: Values, keys: Sequence[str]) -> VehicleModel:
        """Return the model with one more shift."""
        shift = {
            "t_s": max(p[TIME], 0.0),
            **{f"{name}_deg": p[key] / DEG for name, key in zip(ANGLES, KEYS, strict=True)},
        }
        shifts = [*model.dump()["mount"]["shifts"], shift]
        return model.with_changes({"mount.shifts": sorted(shifts, key=lambda x: float(x["t_s"]))})

    def report(self, p: Values, std: Values, keys: Sequence[str]) -> dict[str, Estimated]:
        """Return the shift's rotation vector about vehicle axes, and its time."""
        told = {
            f"mount.shifts.{name}_deg": Estimated(p[key] / DEG, std[key] / DEG, "deg")
            for name, key in zip(ANGLES, KEYS, strict=True)
        }
        return {**told, "mount.shifts.t_s": Estimated(p[TIME], TIME_STD_S, "s")}
