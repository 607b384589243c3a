"""Effects to hide: what each cause does to the truth, and how large it is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hidden.numerics import Array, turn
from hidden.world import DEG, World

Size = Literal["small", "medium", "large"]
LEVEL: Mapping[str, int] = {"small": 0, "medium": 1, "large": 2}
SPREAD = 0.10
"""Sizes vary by this share from drive to drive."""

SIZES: Mapping[str, tuple[float, float, float]] = {
    "mount_rotation": (1.0 * DEG, 3.0 * DEG, 8.0 * DEG),
    "mount_shift": (1.5 * DEG, 3.0 * DEG, 8.0 * DEG),
    "accel_bias": (0.1, 0.25, 0.6),
    "accel_scale": (0.015, 0.04, 0.1),
    "accel_cross_axis": (0.01, 0.03, 0.08),
    "gyro_bias": (0.2 * DEG, 0.6 * DEG, 2.0 * DEG),
    "gyro_scale": (0.02, 0.05, 0.12),
    "gyro_bias_temperature": (0.01 * DEG, 0.03 * DEG, 0.1 * DEG),
    "g_sensitivity": (0.02 * DEG, 0.06 * DEG, 0.2 * DEG),
    "lever_arm": (0.5, 1.5, 3.0),
    "road_grade": (0.02, 0.04, 0.07),
    "road_bank": (0.018, 0.035, 0.06),
    "squat_dive": (0.002, 0.005, 0.012),
    "body_roll": (0.004, 0.009, 0.02),
    "steering_offset": (2.0 * DEG, 5.0 * DEG, 12.0 * DEG),
    "steering_ratio": (0.06, 0.15, 0.30),
    "understeer": (0.0015, 0.003, 0.006),
    "wheel_speed_scale": (0.02, 0.05, 0.10),
    "yaw_rate_scale": (0.025, 0.06, 0.15),
    "yaw_rate_offset": (0.25 * DEG, 0.7 * DEG, 2.0 * DEG),
    "signal_delay": (0.05, 0.15, 0.40),
    "sensor_lowpass": (3.0, 1.2, 0.5),
    "saturation": (0.002, 0.01, 0.05),
    "dropouts": (0.005, 0.02, 0.08),
    "stuck_signal": (0.01, 0.04, 0.12),
    "clock_drift": (400.0, 1500.0, 5000.0),
    "crosswind": (0.2, 0.4, 0.8),
    "trailer_sway": (0.2, 0.5, 1.0),
    "vibration_rectification": (0.7, 2.0, 5.0),
    "sloshing_load": (0.15, 0.30, 0.45),
}
"""SI; what the number is stands in the docstring of the function that hides it."""

STAMPS_PPM = (100.0, 250.0, 600.0)
"""The second form of clock drift: stamps that run off."""
OUTSIDE = ("crosswind", "trailer_sway", "vibration_rectification", "sloshing_load")
OUTSIDE_SIGNALS: Mapping[str, tuple[str, ...]] = {
    "crosswind": ("accel_y", "lateral_accel", "yaw_rate", "gyro_x", "gyro_z"),
    "trailer_sway": ("accel_y", "lateral_accel", "yaw_rate", "gyro_x", "gyro_z"),
    "vibration_rectification": ("accel_x", "accel_y", "accel_z"),
    "sloshing_load": ("accel_y", "lateral_accel", "yaw_rate", "gyro_x", "gyro_z"),
}
"""Signals, triads in vehicle axes, in which an effect outside the catalogue is seen."""
CAUSES = tuple(name for name in SIZES if name not in OUTSIDE)

DELAYABLE = ("speed", "steering", "yaw_rate", "lateral_accel", "accel", "gyro")
BREAKABLE = DELAYABLE
RAILED = ("accel", "gyro", "yaw_rate")


@dataclass(frozen=True)
class Effect:
    """One hidden effect. form: which of several (a signal, an axis); None draws it."""

    cause: str
    size: Size = "medium"
    form: str | None = None


def random_effect(
    rng: np.random.Generator, cause: str | None = None, size: Size | None = None
) -> Effect:
    """Draw an effect of the catalogue; a cause or a size may be given."""
    name = cause if cause is not None else str(rng.choice(CAUSES))
    drawn = size if size is not None else _SIZE_NAMES[int(rng.integers(3))]
    return Effect(name, drawn)


_SIZE_NAMES: tuple[Size, Size, Size] = ("small", "medium", "large")
Hider = Callable[[World, float, np.random.Generator, Effect], None]


def hide(world: World, effect: Effect, rng: np.random.Generator) -> None:
    """Change the truth by an effect of about the size asked for."""
    size = SIZES[effect.cause][LEVEL[effect.size]]
    size *= 1.0 + SPREAD * float(rng.uniform(-1.0, 1.0))
    _HIDERS[effect.cause](world, size, rng, effect)


def _direction(rng: np.random.Generator) -> Array:
    v = rng.standard_normal(3)
    return np.asarray(v / np.linalg.norm(v))


def _sign(rng: np.random.Generator) -> float:
    return 1.0 if rng.random() < 0.5 else -1.0


def _pick(rng: np.random.Generator, effect: Effect, among: tuple[str, ...]) -> str:
    drawn = str(rng.choice(among))
    return effect.form if effect.form is not None else drawn


def _mount_rotation(w: World, size: float, rng: np.random.Generator, e: Effect) -> None:
    """Angle about a random axis."""
    w.R_vehicle_from_sensor = turn(_direction(rng), size) @ w.R_vehicle_from_sensor


def _mount_shift(w: World, size: float, rng: np.random.Generator, e: Effect) -> None:
    """Angle about a random axis, somewhere in the middle half of the drive."""
    w.shift_share = float(rng.uniform(0.25, 0.75))
    w.shift = turn(_direction(rng), size)


def _accel_bias(w: World, size: float, rng: np.random.Generator, e: Effect) -> None:
    """Length of the bias vector."""
    w.accel.bias = w.accel.bias + size * _direction(rng)


def _accel_scale(w: World, size: float, rng: np.random.Generator, e: Effect) -> None:
    """Scale error of one axis, or of all equally."""
    form = _pick(rng, e, ("0", "1", "2", "all"))
    which = np.ones(3) if form == "all" else np.eye(3)[int(form)]
    w.accel.scale = w.accel.scale + _sign(rng) * size * which


def _accel_cross_axis(w: World, size: float, rng: np.random.Generator, e: Effect) -> None:
    """Each of one to three of the six terms."""
    chosen = rng.choice(6, int(rng.integers(1, 4)), replace=False)
    change = np.zeros(6)
    change[chosen] = [size * _sign(rng) for _ in chosen]
    w.accel.cross_axis = w.accel.cross_axis + change


def _gyro_bias(w: World, size: float, rng: np.random.Generator, e: Effect) -> None:
    """Length of the bias vector."""
    w.gyro.bias = w.gyro.bias + size * _direction(rng)


def _gyro_scale(w: World, size: float, rng: np.random.Generator, e: Effect) -> None:
    """Scale error of the axis nearest to the vertical, or of all equally."""
    form = _pick(rng, e, ("vertical", "all"))
    vertical = np.eye(3)[int(np.argmax(np.abs(w.R_vehicle_from_sensor[2])))]
    w.gyro.scale = w.gyro.scale + _sign(rng) * size * (vertical if form == "vertical" else 1.0)


def _gyro_bias_temperature(w: World, size: float, rng: np.random.Generator, e: Effect) -> None:
    """Length of the vector of bias per kelvin."""
    w.gyro.bias_temperature = w.gyro.bias_temperature + size * _direction(rng)


def _g_sensitivity(w: World, size: float, rng: np.random.Generator, e: Effect) -> None:
    """Of one axis, or of each."""
    form = _pick(rng, e, ("0", "1", "2", "all"))
    which = np.ones(3) if form == "all" else np.eye(3)[int(form)]
    w.gyro.g_sensitivity = w.gyro.g_sensitivity + _sign(rng) * size * which


def _lever_arm(w: World, size: float, rng: np.random.Generator, e: Effect) -> None:
    """Distance by which the sensor is elsewhere, mostly along the vehicle."""
    aside = np.array([_sign(rng), 0.25 * rng.standard_normal(), 0.12 * rng.standard_normal()])
    w.lever_arm = w.lever_arm + size * aside / np.linalg.norm(aside)


def _road_grade(w: World, size: float, rng: np.random.Generator, e: Effect) -> None:
    """rms of the slope over the road."""
    w.grade_rms = size


def _road_bank(w: World, size: float, rng: np.random.Generator, e: Effect) -> None:
    """rms of the cross fall about the crown, over the road."""
    w.bank_rms = size


def _squat_dive(w: World, size: float, rng: np.random.Generator, e: Effect) -> None:
    """Added to both gradients; taken away where something is left."""
    way = _sign(rng) if min(w.squat, w.dive) > size else 1.0
    w.squat, w.dive = w.squat + way * size, w.dive + way * size


def _body_roll(w: World, size: float, rng: np.random.Generator, e: Effect) -> None:
    """Added to the roll gradient; small ones may be taken away."""
    way = _sign(rng) if e.size == "small" and w.roll_gradient > size else 1.0
    w.roll_gradient += way * size


def _steering_offset(w: World, size: float, rng: np.random.Generator, e: Effect) -> None:
    """At the steering wheel."""
    w.steering_offset += _sign(rng) * size


def _steering_ratio(w: World, size: float, rng: np.random.Generator, e: Effect) -> None:
    """Share of the ratio."""
    w.steering_ratio *= 1.0 + _sign(rng) * size


def _understeer(w: World, size: float, rng: np.random.Generator, e: Effect) -> None:
    """Added to the gradient; small ones may be taken away."""
    way = _sign(rng) if e.size == "small" and w.understeer > size + 0.0003 else 1.0
    w.understeer += way * size


def _wheel_speed_scale(w: World, size: float, rng: np.random.Generator, e: Effect) -> None:
    """Speed and all wheels by one factor."""
    change = _sign(rng) * size
    w.speed_scale += change
    w.wheel_scale = w.wheel_scale + change


def _yaw_rate_scale(w: World, size: float, rng: np.random.Generator, e: Effect) -> None:
    """Of the vehicle's yaw rate."""
    w.yaw_scale += _sign(rng) * size


def _yaw_rate_offset(w: World, size: float, rng: np.random.Generator, e: Effect) -> None:
    """Of the vehicle's yaw rate."""
    w.yaw_offset += _sign(rng) * size


def _signal_delay(w: World, size: float, rng: np.random.Generator, e: Effect) -> None:
    """Added to the age of one signal."""
    w.channels[_pick(rng, e, DELAYABLE)].delay_s += size


def _sensor_lowpass(w: World, size: float, rng: np.random.Generator, e: Effect) -> None:
    """Cut-off that takes the place of the sensor's own."""
    w.channels[_pick(rng, e, RAILED)].lowpass_hz = size


def _saturation(w: World, size: float, rng: np.random.Generator, e: Effect) -> None:
    """Share of the samples, while driving, in which an axis sits on the rail."""
    w.channels[_pick(rng, e, RAILED)].clipped_share = size


def _dropouts(w: World, size: float, rng: np.random.Generator, e: Effect) -> None:
    """Share of one signal's frames that are lost, in bursts."""
    w.channels[_pick(rng, e, BREAKABLE)].lost_share = size


def _stuck_signal(w: World, size: float, rng: np.random.Generator, e: Effect) -> None:
    """Share of the time in which one signal does not change."""
    w.channels[_pick(rng, e, BREAKABLE)].frozen_share = size


def _clock_drift(w: World, size: float, rng: np.random.Generator, e: Effect) -> None:
    """ppm: the inertial unit's cycle is off (`cycle`), or its stamps run off (`stamps`)."""
    form, way = _pick(rng, e, ("cycle", "stamps")), _sign(rng)
    for name in ("accel", "gyro"):
        channel = w.channels[name]
        if form == "cycle":
            channel.cycle_ppm += way * size
        else:
            usual = SIZES[e.cause][LEVEL[e.size]]
            channel.stamps_ppm = way * size / usual * STAMPS_PPM[LEVEL[e.size]]


def _crosswind(w: World, size: float, rng: np.random.Generator, e: Effect) -> None:
    """rms of the wind's push per mass [m/s^2]."""
    w.gusts = size


def _trailer_sway(w: World, size: float, rng: np.random.Generator, e: Effect) -> None:
    """Amplitude of the trailer's pull per mass [m/s^2]."""
    w.sway = size


def _rectification(w: World, size: float, rng: np.random.Generator, e: Effect) -> None:
    """Mean shift per mean square of the vibration [(m/s^2)/(m/s^2)^2]."""
    w.accel.rectification = size * _direction(rng)
    # A part that rectifies sits where it is shaken.
    w.accel.vibration = np.maximum(w.accel.vibration, 0.15)


def _sloshing(w: World, size: float, rng: np.random.Generator, e: Effect) -> None:
    """Share of the vehicle's mass that swings, at 0.4 to 0.8 Hz."""
    w.slosh_mass, w.slosh_hz = size, float(rng.uniform(0.4, 0.8))


_HIDERS: Mapping[str, Hider] = {
    "mount_rotation": _mount_rotation,
    "mount_shift": _mount_shift,
    "accel_bias": _accel_bias,
    "accel_scale": _accel_scale,
    "accel_cross_axis": _accel_cross_axis,
    "gyro_bias": _gyro_bias,
    "gyro_scale": _gyro_scale,
    "gyro_bias_temperature": _gyro_bias_temperature,
    "g_sensitivity": _g_sensitivity,
    "lever_arm": _lever_arm,
    "road_grade": _road_grade,
    "road_bank": _road_bank,
    "squat_dive": _squat_dive,
    "body_roll": _body_roll,
    "steering_offset": _steering_offset,
    "steering_ratio": _steering_ratio,
    "understeer": _understeer,
    "wheel_speed_scale": _wheel_speed_scale,
    "yaw_rate_scale": _yaw_rate_scale,
    "yaw_rate_offset": _yaw_rate_offset,
    "signal_delay": _signal_delay,
    "sensor_lowpass": _sensor_lowpass,
    "saturation": _saturation,
    "dropouts": _dropouts,
    "stuck_signal": _stuck_signal,
    "clock_drift": _clock_drift,
    "crosswind": _crosswind,
    "trailer_sway": _trailer_sway,
    "vibration_rectification": _rectification,
    "sloshing_load": _sloshing,
}
