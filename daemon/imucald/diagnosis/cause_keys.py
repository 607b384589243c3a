"""Read and write the keys of the causes in a model.

`imucald.model` reads and writes the file itself.

`Changes` maps a key to the difference from the value of the model file. Vectors in `Changes` are
along the vehicle's axes. This module rotates these vectors into the sensor's axes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from imucald.core.arrays import Array
from imucald.core.rotations import (
    Matrix3,
    angles_from_rotation,
    rotation_from_vector,
)
from imucald.core.samples import GRAVITY
from imucald.diagnosis.causes import LEVEL_GYRO_GAIN_ERROR, MODEL_ERROR, PARAMETERS, family
from imucald.diagnosis.signals import SIGNALS
from imucald.model.model import VehicleModel
from imucald.model.sensors import BUTTERWORTH_S_HZ, LONGEST_DELAY_S
from imucald.simulation.imu import gain_matrix, mounts

Changes = Mapping[str, float]
TRIADS = ("accel", "gyro")


@dataclass(frozen=True)
class Sensor:
    """Errors of a triad in sensor axes: measured = gain @ true + bias."""

    gain: Array
    bias: Array
    per_kelvin: Array
    per_force: Array
    """g-sensitivity of each axis (3,), the diagonal of a matrix."""


def sensor_of(model: VehicleModel, name: str, changes: Changes) -> Sensor:
    """Return the errors of a triad: the values of the model file plus `changes`. Only changes of
    scale, cross-axis and g-sensitivity are used."""
    triad = getattr(model, name)
    scale = _sum(triad.scale, _indexed(changes, f"{name}.scale", 3))
    cross = _sum(triad.cross_axis, _indexed(changes, f"{name}.cross_axis", 6))
    gain = gain_matrix(msgspec.structs.replace(triad, scale=scale, cross_axis=cross))
    per_force = np.zeros(3)
    if name == "gyro":
        per_force = np.array(triad.g_sensitivity) + _indexed(changes, "gyro.g_sensitivity", 3)
    return Sensor(gain, np.array(triad.bias), np.array(triad.bias_temperature), per_force)


def _indexed(changes: Changes, key: str, n: int) -> Array:
    return np.array([changes.get(f"{key}.{i}", 0.0) for i in range(n)])


def along_vehicle(changes: Changes, key: str) -> Array:
    """Return the change of a vector (3,) along the vehicle's axes."""
    return np.array([changes.get(f"{key}.{axis}", 0.0) for axis in "xyz"])


def mount_of(model: VehicleModel) -> Matrix3:
    """Return R_vehicle_from_sensor (3, 3) at the start of the drive."""
    return mounts(model.mount)[0][1]


def age(model: VehicleModel, name: str) -> float:
    """Return the age of a signal when its frame arrives [s]: delay of the signal plus delay of its
    low-pass filter."""
    message = getattr(model, name)
    seconds = float(message.delay_s)
    cut_off = getattr(message, "lowpass_hz", None)
    if cut_off is not None:
        seconds += BUTTERWORTH_S_HZ / cut_off
    return seconds + float(getattr(message, "time_constant_s", 0.0))


def value(model: VehicleModel, key: str) -> float:
    """Return a number of the model file. A key without a place in the file gives 0. A key of a
    vector component gives the component along the vehicle's axis."""
    place: Any = model
    for part in key.split("."):
        if part.isdigit() and isinstance(place, tuple):
            place = place[int(part)]
        elif hasattr(place, part):
            place = getattr(place, part)
        else:
            return _vector_value(model, key)
    return float(place[0]) if isinstance(place, tuple) else float(place)


def _vector_value(model: VehicleModel, key: str) -> float:
    """Return the component of a vector along a vehicle axis. The file contains the vector in sensor
    axes."""
    section, _, name = family(key).partition(".")
    stated, axis = getattr(getattr(model, section, None), name, None), key[-1]
    if axis not in "xyz" or not isinstance(stated, tuple):
        return 0.0
    return float((mount_of(model) @ np.array(stated))["xyz".index(axis)])


def tolerance(model: VehicleModel, key: str) -> float:
    """Return the allowed error of a value of the model file: the error that the file states
    (`known_to`), or else the tolerance of the catalogue."""
    stated = model.known_to.get(key)
    return usual_tolerance(model, key) if stated is None else stated


def usual_tolerance(model: VehicleModel, key: str) -> float:
    """Return the error that a value of a correct model file may have if the file does not state its
    accuracy."""
    row = PARAMETERS[key]
    return row.tolerance * (abs(value(model, key)) if row.relative else 1.0)


def plausible(model: VehicleModel, key: str) -> tuple[float, float]:
    """Return the range of the difference from the model file that a real vehicle or sensor can
    have."""
    row = PARAMETERS[key]
    size = abs(value(model, key)) if row.relative else 1.0
    return row.plausible[0] * size, row.plausible[1] * size


def is_unstated(model: VehicleModel, key: str) -> bool:
    """True if the model file allows every plausible value of a parameter (`known_to`)."""
    return model.known_to.get(key, 0.0) >= max(map(abs, plausible(model, key)))


def model_error(model: VehicleModel, key: str) -> float:
    """Return the error of the equations in a parameter, as one standard deviation."""
    stated = MODEL_ERROR.get(family(key), 0.0)
    if key.startswith("gyro.scale."):
        upright = float(abs(mount_of(model)[2, int(key[-1])]))
        return float(np.hypot(stated * upright, LEVEL_GYRO_GAIN_ERROR * (1.0 - upright**2) ** 0.5))
    return stated * abs(value(model, key)) if PARAMETERS[key].relative else stated


# writing -----------------------------------------------------------------------------------------


def extended(model: VehicleModel, changes: Changes) -> VehicleModel:
    """Return the model file with changes applied."""
    made: dict[str, Any] = {}
    R = mount_of(model)
    for name in TRIADS:
        _write_triad(made, model, name, changes, R)
    turn = along_vehicle(changes, "mount.turn")
    if turn.any():
        angles = angles_from_rotation(rotation_from_vector(turn) @ R)
        for angle, x in zip(("roll", "pitch", "yaw"), angles, strict=True):
            made[f"mount.{angle}_deg"] = math.degrees(x)
    lever = _indexed(changes, "mount.lever_arm_m", 3)
    if lever.any():
        made["mount.lever_arm_m"] = _sum(model.mount.lever_arm_m, lever)
    made |= _delays(model, changes)
    for key, x in changes.items():
        section, _, name = key.partition(".")
        is_number = hasattr(getattr(model, section, None), name) and not name.endswith("delay_s")
        if x and is_number and key not in made and key != "wheel_speeds.scale":
            made[key] = value(model, key) + x
    wheels = changes.get("wheel_speeds.scale", 0.0) + changes.get("speed.scale", 0.0)
    if wheels:
        made["wheel_speeds.scale"] = tuple(s + wheels for s in model.wheel_speeds.scale)
    return model.with_changes(made)


def _sum(stated: Sequence[float], change: Array) -> tuple[float, ...]:
    return tuple(float(a + b) for a, b in zip(stated, change, strict=True))


def _write_triad(
    made: dict[str, Any], model: VehicleModel, name: str, changes: Changes, R: Matrix3
) -> None:
    """Write the changes of a triad into `made`. Vectors along the vehicle's axes are rotated into
    sensor axes."""
    triad = getattr(model, name)
    gain = sensor_of(model, name, changes).gain
    for what in ("bias", "bias_temperature"):
        change = gain @ R.T @ along_vehicle(changes, f"{name}.{what}")
        if what == "bias":
            change += _at_one_g(model, name, changes, R)
        if change.any():
            made[f"{name}.{what}"] = _sum(getattr(triad, what), change)
    for what, n in (("scale", 3), ("cross_axis", 6), ("g_sensitivity", 3)):
        change = _indexed(changes, f"{name}.{what}", n)
        if change.any():
            made[f"{name}.{what}"] = _sum(getattr(triad, what), change)


def _at_one_g(model: VehicleModel, name: str, changes: Changes, R: Matrix3) -> Array:
    """Return the zero error that cancels the effect of a gain change on the reading at one g
    upright. `Changes` define a gain so that the reading at one g stays the same."""
    level = R.T @ np.array([0.0, 0.0, GRAVITY])
    if name == "gyro":
        return np.asarray(-_indexed(changes, "gyro.g_sensitivity", 3) * level)
    change = sensor_of(model, name, changes).gain - sensor_of(model, name, {}).gain
    return np.asarray(-change @ level)


def level_effect(model: VehicleModel, key: str) -> dict[str, float]:
    """Return the zero error along the vehicle's axes that a gain error of the accelerometer causes
    at one g, per unit of the gain."""
    R = mount_of(model)
    change = sensor_of(model, "accel", {key: 1.0}).gain - sensor_of(model, "accel", {}).gain
    offset = R @ change @ R.T @ np.array([0.0, 0.0, GRAVITY])
    return {f"accel.bias.{axis}": float(x) for axis, x in zip("xyz", offset, strict=True)}


def _delays(model: VehicleModel, changes: Changes) -> dict[str, Any]:
    """Return the delays of all signals. No delay is negative. If the age of one signal would be
    negative, the ages of all signals are increased by the same time.

    Delays are limited to the range of the file, because the fit diverges if no delay explains the
    data.
    """
    moved = [key for key in changes if key.endswith("delay_s") and changes[key] != 0.0]
    if not moved:
        return {}
    delays = {n: getattr(model, n).delay_s + changes.get(f"{n}.delay_s", 0.0) for n in SIGNALS}
    if "speed.delay_s" in changes:
        delays["wheel_speeds"] += changes["speed.delay_s"]
    lift = max(0.0, -min(delays.values()))
    return {
        f"{name}.delay_s": min(max(x + lift, 0.0), LONGEST_DELAY_S)
        for name, x in delays.items()
        if abs(x + lift - getattr(model, name).delay_s) > 1e-9
    }


def low_pass(model: VehicleModel, key: str, x: float) -> tuple[str, float] | None:
    """Return key and value of a low-pass filter that delays a signal by x [s] more than the file
    states. None if the file has no place for such a filter. key: key of the delay."""
    name = key.partition(".")[0]
    seconds = age(model, name) - getattr(model, name).delay_s + x
    if seconds <= 0.0 or name == "wheel_speeds":
        return None
    if hasattr(getattr(model, name), "lowpass_hz"):
        return f"{name}.lowpass_hz", BUTTERWORTH_S_HZ / seconds
    return f"{name}.time_constant_s", seconds


def with_low_passes(model: VehicleModel, stated: VehicleModel, late: Changes) -> VehicleModel:
    """Return the model file with filters in place of delays. stated: model file before the
    diagnosis. late: for each delay, the part that the filter causes [s]."""
    made: dict[str, float] = {}
    for key, x in late.items():
        name = key.partition(".")[0]
        if (filtered := low_pass(stated, key, x)) is not None:
            made[filtered[0]] = filtered[1]
            made[key] = max(getattr(model, name).delay_s - x, 0.0)
    return model.with_changes(made) if made else model


def rear_slip(model: VehicleModel) -> float:
    """Return the sideslip speed at the rear axle, divided by speed and lateral acceleration: m l_f
    / (L C_r) [s^2/m]."""
    c = model.chassis
    return c.mass_kg * c.cg_to_front_m / (c.wheelbase_m * c.rear_cornering_stiffness_npr)


def with_shifts(model: VehicleModel, shifts: Sequence[tuple[float, Array]]) -> VehicleModel:
    """Return the model file with turns (3,) [rad] about the vehicle's axes at given times [s]."""
    added = []
    for t, turn in shifts:
        angles = [math.degrees(x) for x in angles_from_rotation(rotation_from_vector(turn))]
        roll, pitch, yaw = (round(x, 4) for x in angles)
        added.append({"t_s": max(t, 0.0), "roll_deg": roll, "pitch_deg": pitch, "yaw_deg": yaw})
    data = [msgspec.to_builtins(s) for s in model.mount.shifts] + added
    return model.with_changes({"mount.shifts": tuple(sorted(data, key=lambda s: s["t_s"]))})


def with_delay_rate(changes: Changes, middle_s: float) -> dict[str, float]:
    """Return the changes with the delay at the start of the drive. The fit uses the delay in the
    middle of the drive."""
    rate = changes.get("speed.delay_rate", 0.0)
    made = dict(changes)
    if rate:
        made["speed.delay_s"] = made.get("speed.delay_s", 0.0) - rate * middle_s
    return made
