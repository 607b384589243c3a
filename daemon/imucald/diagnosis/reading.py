"""One drive read against a model file: each signal at its age, with its known errors taken off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucald.core.rotations import rotation_from_vector
from imucald.core.samples import GRAVITY
from imucald.diagnosis.cause_keys import Changes, age, along_vehicle, mounts, sensor_of
from imucald.diagnosis.signals import Array, DriveSignals
from imucald.model.model import VehicleModel

REFERENCE_DEGC = 25.0


@dataclass(frozen=True)
class Reference:
    """Signals for columns, each without the noise of the equation in which it stands."""

    slopes: Array
    """Of the speed between its knots, by speed and accelerometer."""
    force: Array
    """(N, 3) along the vehicle: forward by speed and accelerometer, sideways as predicted, upward
    gravity."""
    leaning: Array
    """(N,) sideways force less speed times yaw rate, as measured: what leans the vehicle."""
    rate: Array | None = None
    """(N, 3) of turning, about the vertical by the vehicle's own yaw rate where there is one."""
    steered: Array | None = None
    """(N,) yaw rate by the steering angle."""


class Reader:
    """Signals of a drive on its grid, block by block; arrays (N,) or (N, 3)."""

    def __init__(self, drive: DriveSignals, model: VehicleModel, rows: int) -> None:
        self.drive, self.model = drive, model
        self.rows = rows
        self.blocks = len(drive.t) // rows
        spare = len(drive.t) - self.blocks * rows
        self.t = drive.t[spare // 2 : spare // 2 + self.blocks * rows]
        self.has_gravity = drive.has("gyro")
        self.has_turning = drive.has("gyro") or drive.has("yaw_rate")
        self.middle_s = float(self.t[len(self.t) // 2]) if self.blocks else 0.0
        self._read: dict[tuple[str, float], Array] = {}
        self.knots = drive.knots.t
        self.reference: Reference | None = None

    def raw(self, name: str, later: float) -> Array:
        """Means over the grid's step, read later by so much [s]."""
        key = (name, round(later, 6))
        if key not in self._read:
            self._read[key] = self.drive.channels[name].means(self.t + later)
        return self._read[key]

    def age(self, name: str, changes: Changes) -> float:
        """How old a signal is when it comes [s]."""
        return age(self.model, name) + changes.get(f"{name}.delay_s", 0.0)

    def triad(self, name: str, changes: Changes, force: Array | None = None) -> Array:
        """(N, 3) along the vehicle's axes, with the model file's errors taken off.

        force: (N, 3) along the vehicle's axes that takes the place of what was measured, and has
        none of the file's errors.
        """
        sensor = sensor_of(self.model, name, changes)
        if force is None:
            raw = self.raw(name, self.age(name, changes)) - sensor.bias
        else:
            raw = self.in_sensor(force, changes.get(f"{name}.delay_s", 0.0), name)
        warm = self.above_reference() if self.drive.has("temperature") else None
        if warm is not None and sensor.per_kelvin.any() and force is None:
            raw = raw - warm[:, None] * sensor.per_kelvin
        if sensor.per_force.any():
            stated = np.array(self.model.gyro.g_sensitivity)
            if force is None:
                raw = raw - stated * self.raw("accel", self.age("accel", changes))
            if (sensor.per_force != stated).any():
                level = self.in_sensor(np.tile([0.0, 0.0, GRAVITY], (len(self.t), 1)), 0.0, name)
                felt = self.raw("accel", self.age("accel", changes)) - level
                raw = raw - (sensor.per_force - stated) * felt
        true = raw @ np.linalg.inv(sensor.gain).T
        if name == "accel" and any(_is_gain(key) for key in changes):
            # A gain turns about one g upright; what it makes of that is a zero error.
            level = self.in_sensor(np.tile([0.0, 0.0, GRAVITY], (len(self.t), 1)), 0.0, name)
            stated = np.linalg.inv(sensor_of(self.model, name, {}).gain)
            true += level @ (stated - np.linalg.inv(sensor.gain)).T
        made = np.empty_like(true)
        turn = rotation_from_vector(along_vehicle(changes, "mount.turn"))
        for start, R in mounts(self.model):
            after = self.t >= start
            made[after] = true[after] @ (turn @ R).T
        made -= along_vehicle(changes, f"{name}.bias")
        drift = along_vehicle(changes, f"{name}.bias_temperature")
        if warm is not None and drift.any():
            made -= warm[:, None] * drift
        return made

    def in_sensor(self, force: Array, later: float, name: str) -> Array:
        """What a triad without a zero error would say of a force (N, 3) at a later time."""
        if later:
            force = np.column_stack([np.interp(self.t + later, self.t, x) for x in force.T])
        turned = np.empty_like(force)
        for start, R in mounts(self.model):
            after = self.t >= start
            turned[after] = force[after] @ R
        return np.asarray(turned @ sensor_of(self.model, name, {}).gain.T)

    def above_reference(self) -> Array:
        """Temperature less that at which the file's zero errors hold [K]."""
        return np.asarray(self.raw("temperature", 0.0) - REFERENCE_DEGC)

    def scalar(self, name: str, changes: Changes, true: Array | None = None) -> Array:
        """A signal of the vehicle's bus with offset and scale taken off.

        true: (N,) what takes the place of the measured one, as it is without any error.
        """
        part = getattr(self.model, name)
        offset = part.offset + changes.get(f"{name}.offset", 0.0)
        scale = part.scale + changes.get(f"{name}.scale", 0.0)
        if true is None:
            shown = self.raw(name, self.age(name, changes))
        else:
            later = changes.get(f"{name}.delay_s", 0.0)
            shown = np.interp(self.t + later, self.t, true) * (1.0 + part.scale) + part.offset
        return np.asarray((shown - offset) / (1.0 + scale))

    # evaluation ----------------------------------------------------------------------------------


def _is_gain(key: str) -> bool:
    return key.startswith(("accel.scale", "accel.cross_axis"))
