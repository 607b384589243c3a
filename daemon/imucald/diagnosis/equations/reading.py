"""Read one drive with a model file: each signal is shifted by its age, and its known errors are
removed. Results are kept, because a column of a fit is an evaluation with one changed number, and
most signals of this evaluation stay the same."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from imucald.core.arrays import Array
from imucald.core.rotations import rotation_from_vector
from imucald.core.samples import GRAVITY
from imucald.diagnosis.cause_keys import Changes, age, along_vehicle, sensor_of
from imucald.diagnosis.signals import DriveSignals
from imucald.drive.equations import Axes
from imucald.model.model import VehicleModel
from imucald.model.sensors import REFERENCE_DEGC
from imucald.simulation.imu import mounts

T = TypeVar("T")
Known = dict[tuple[Any, ...], tuple[tuple[Any, ...], Any]]
GAINS = ("accel.scale", "accel.cross_axis")
Part = tuple[tuple[str, float], ...]
"""Changes, as pairs of key and value."""
OF_TRIAD = {
    "accel": ("accel.", "mount.turn."),
    "gyro": ("gyro.", "mount.turn.", "accel.delay_s"),
}
"""Beginnings of the keys that change the values of a triad."""


class Once:
    """Calls a function, unless its result for these inputs is already known.

    Inputs are the same if arrays are the same objects and all other inputs are equal. The result of
    the function must therefore depend on its inputs only. The stored arrays are made read-only.
    keeps: if True, new results are stored in `known`. If False, new results are stored only as long
    as this object exists.
    """

    def __init__(self, known: Known, keeps: bool) -> None:
        self._known = known
        self._new = known if keeps else {}

    def __call__(self, make: Callable[..., T], *inputs: Any) -> T:
        """Return the result of `make` for these inputs. Functions are identified by their names."""
        key = (make.__name__, *((id(x),) if isinstance(x, np.ndarray) else x for x in inputs))
        found = self._known.get(key) or self._new.get(key)
        if found is not None:
            known: T = found[1]
            return known
        made = make(*inputs)
        # Inputs are kept too, because an array's id is unique only while the array lives.
        self._new[key] = inputs, made
        for x in made if isinstance(made, tuple) else (made,):
            if isinstance(x, np.ndarray):
                x.flags.writeable = False
        return made


@dataclass(frozen=True)
class Reference:
    """Signals for columns, each without the noise of its own equation."""

    slopes: Array
    """Slopes of the speed between successive knots, from speed and accelerometer."""
    force: Array
    """Force (N, 3) along the vehicle's axes: forward from speed and accelerometer, sideways as
    predicted, upward gravity."""
    leaning: Array
    """Measured sideways force minus speed times yaw rate (N,): the force that makes the vehicle
    lean."""
    rate: Array | None = None
    """Angular rate (N, 3). The vertical component of the angular rate is the vehicle's own yaw rate
    if there is such a signal."""
    steered: Array | None = None
    """Yaw rate (N,) from the steering angle."""


class Reader:
    """Signals of a drive on its time grid, block by block. Arrays are (N,) or (N, 3)."""

    def __init__(self, drive: DriveSignals, model: VehicleModel, rows: int) -> None:
        self.drive, self.model = drive, model
        self.rows = rows
        self.mounts = mounts(model.mount)
        self.blocks = len(drive.t) // rows
        spare = len(drive.t) - self.blocks * rows
        self.t = drive.t[spare // 2 : spare // 2 + self.blocks * rows]
        self.has_gravity = drive.has("gyro")
        self.has_turning = drive.has("gyro") or drive.has("yaw_rate")
        self.middle_s = float(self.t[len(self.t) // 2]) if self.blocks else 0.0
        self._read: dict[tuple[str, float], Array] = {}
        self.known: Known = {}
        self.knots = drive.knots.t
        self.reference: Reference | None = None

    def forget(self) -> None:
        """Delete the signals to free memory. The signals are read again when needed."""
        self._read.clear()
        self.known.clear()
        self.reference = None

    def in_blocks(self, x: Array) -> Array:
        """Return rows (N,) as blocks (B, n)."""
        return x.reshape(self.blocks, self.rows)

    def amount_of_speed(self) -> Array:
        """Return the absolute value of the indicated speed (N,) [m/s]."""
        return np.interp(self.t, self.knots, np.abs(self.drive.knots.values))

    def raw(self, name: str, later: float) -> Array:
        """Return the means of a signal over the grid step, read `later` seconds later."""
        key = (name, round(later, 6))
        if key not in self._read:
            self._read[key] = self.drive.channels[name].means(self.t + later)
        return self._read[key]

    def age(self, name: str, changes: Changes) -> float:
        """Return the age of a signal when its frame is received [s]."""
        return age(self.model, name) + changes.get(f"{name}.delay_s", 0.0)

    def knots_at(self, late: float, rate: float) -> Array:
        """Return the times of the speed's knots. late: delay of the speed [s]. rate: growth of this
        delay per second."""
        age = late + self.model.speed.delay_rate * self.knots
        age += rate * (self.knots - self.middle_s)
        return np.asarray(self.knots - age)

    def triad(self, name: str, changes: Changes, force: Array | None = None) -> Axes:
        """Return the components (N,) along the vehicle's axes, without the errors that the model
        file states. An axis that the changes do not affect stays the same array object.

        force: (N, 3) along the vehicle's axes; it replaces the measured values and has no errors.
        """
        own = _part(changes, OF_TRIAD[name])
        return Once(self.known, not own)(self._triad, name, own, force)

    def _triad(self, name: str, own: Part, force: Array | None) -> Axes:
        """Return the result of `_with_its_zero` along the vehicle's axes, minus the changes of the
        zero error."""
        zero = (f"{name}.bias.", f"{name}.bias_temperature.")
        others = tuple((key, x) for key, x in own if not key.startswith(zero))
        once = Once(self.known, not others)
        whole = once(self._with_its_zero, name, others, force)
        changes = dict(own)
        bias = along_vehicle(changes, f"{name}.bias")
        drift = along_vehicle(changes, f"{name}.bias_temperature")
        is_warm = drift.any() and self.drive.has("temperature")
        made = []
        for i in range(3):
            x = once(column, whole, i)
            x = x - bias[i] if bias[i] else x
            made.append(x - self.above_reference() * drift[i] if is_warm and drift[i] else x)
        return made[0], made[1], made[2]

    def _with_its_zero(self, name: str, own: Part, force: Array | None) -> Array:
        """Return the triad according to the model file, with all changes except changes of its zero
        error."""
        changes = dict(own)
        sensor = sensor_of(self.model, name, changes)
        if force is None:
            raw = self.raw(name, self.age(name, changes)) - sensor.bias
        else:
            raw = self.in_sensor(force, changes.get(f"{name}.delay_s", 0.0), name)
        if sensor.per_kelvin.any() and force is None and self.drive.has("temperature"):
            raw = raw - self.above_reference()[:, None] * sensor.per_kelvin
        if sensor.per_force.any():
            stated = np.array(self.model.gyro.g_sensitivity)
            if force is None:
                raw = raw - stated * self.raw("accel", self.age("accel", changes))
            if (sensor.per_force != stated).any():
                felt = self.raw("accel", self.age("accel", changes)) - self._level(name)
                raw = raw - (sensor.per_force - stated) * felt
        true = raw @ np.linalg.inv(sensor.gain).T
        if name == "accel" and any(key.startswith(GAINS) for key in changes):
            # A gain is defined about one g upright; its effect on that one g counts as a zero
            # error.
            stated = np.linalg.inv(sensor_of(self.model, name, {}).gain)
            true += self._level(name) @ (stated - np.linalg.inv(sensor.gain)).T
        turn = rotation_from_vector(along_vehicle(changes, "mount.turn"))
        return self._turned(true, [(start, (turn @ R).T) for start, R in self.mounts])

    def _turned(self, x: Array, turns: Sequence[tuple[float, Array]]) -> Array:
        """Multiply x (N, 3) by the matrix that is valid at each time. turns: pairs of a start time
        [s] and a matrix. The first matrix is also valid before its start time."""
        made = x @ turns[0][1]
        for start, R in turns[1:]:
            after = self.t >= start
            made[after] = x[after] @ R
        return np.asarray(made)

    def in_sensor(self, force: Array, later: float, name: str) -> Array:
        """Return the reading of a triad without zero error for a force (N, 3), read `later` seconds
        later."""
        return Once(self.known, not later)(self._in_sensor, force, later, name)

    def _in_sensor(self, force: Array, later: float, name: str) -> Array:
        if later:
            force = np.column_stack([np.interp(self.t + later, self.t, x) for x in force.T])
        turned = self._turned(force, self.mounts)
        return np.asarray(turned @ sensor_of(self.model, name, {}).gain.T)

    def _level(self, name: str) -> Array:
        """Return the reading of a triad for one g upright."""
        return Once(self.known, True)(self._level_in_sensor, name)

    def _level_in_sensor(self, name: str) -> Array:
        upright = np.tile([0.0, 0.0, GRAVITY], (len(self.t), 1))
        return self._in_sensor(upright, 0.0, name)

    def above_reference(self) -> Array:
        """Return the temperature minus the temperature at which the zero errors of the model file
        are valid [K]."""
        return np.asarray(self.raw("temperature", 0.0) - REFERENCE_DEGC)

    def scalar(self, name: str, changes: Changes, true: Array | None = None) -> Array:
        """Return a signal of the vehicle's bus, with offset and scale error removed.

        true: (N,) error-free signal that replaces the measured signal.
        """
        own = _part(changes, (f"{name}.",))
        return Once(self.known, not own)(self._scalar, name, own, true)

    def _scalar(self, name: str, own: Part, true: Array | None) -> Array:
        part, changes = getattr(self.model, name), dict(own)
        offset = part.offset + changes.get(f"{name}.offset", 0.0)
        scale = part.scale + changes.get(f"{name}.scale", 0.0)
        if true is None:
            shown = self.raw(name, self.age(name, changes))
        else:
            later = changes.get(f"{name}.delay_s", 0.0)
            shown = np.interp(self.t + later, self.t, true) * (1.0 + part.scale) + part.offset
        return np.asarray((shown - offset) / (1.0 + scale))


def _part(changes: Changes, beginnings: tuple[str, ...]) -> Part:
    return tuple((key, x) for key, x in changes.items() if key.startswith(beginnings))


def column(x: Array, i: int) -> Array:
    """Return one axis (N,) of x (N, 3), as a contiguous array."""
    return np.ascontiguousarray(x[:, i])
