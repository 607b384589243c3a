"""The sensor is turned in mid-drive."""

from __future__ import annotations

import numpy as np

from imucald.diagnosis.cause import Cause, Parameter, Values
from imucald.diagnosis.state import State
from imucald.frames import rotation_from_vector
from imucald.simulation.model import Model

KEYS = ("_shift.x", "_shift.y", "_shift.z")
TIME = "_shift.t"
"""Time of the shift [s]; searched, not fitted."""
DEG = 0.017453292519943295


class MountShift(Cause):
    """From a time on, R_vehicle_from_sensor = exp(rotation vector) * what it was."""

    name = "mount_shift"
    parameters = (
        *(
            Parameter(key, "rad", 0.01 * DEG, 4.0 * DEG, 0.2 * DEG, label=f"mount.shifts.{label}")
            for key, label in zip(KEYS, ("roll_deg", "pitch_deg", "yaw_deg"), strict=True)
        ),
    )
    signals = ("accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z")
    seen_by = "drive on for ten minutes with stops, brakings and turns both ways"
    sentence = "The sensor was turned during the drive."

    def mount(self, s: State, p: Values) -> None:
        """Turn the sensor from the time on."""
        vector = [p[key] for key in KEYS]
        if any(vector):
            s.turns.append((p[TIME], rotation_from_vector(np.negative(vector))))

    def extend(self, model: Model, p: Values) -> Model:
        """Return the model with one more shift."""
        shift = {
            "t_s": max(p[TIME], 0.0),
            **{f"{name}_deg": float(np.degrees(p[key]))
               for name, key in zip(("roll", "pitch", "yaw"), KEYS, strict=True)},
        }  # fmt: skip
        shifts = [*model.model_dump()["mount"]["shifts"], shift]
        return model.with_changes({"mount.shifts": sorted(shifts, key=lambda x: float(x["t_s"]))})
