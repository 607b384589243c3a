"""Read a model file for use while driving: its terms, and one line for each part that is not used.

The schema defines the keys, their types and their ranges (`imucald.model`). This module defines the
use of each key, and the largest values that are corrected.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from imucald.core.samples import FLAGS, VEHICLE_SIGNALS
from imucald.model.section import ZERO, Vector3
from imucald.model.sensors import BUTTERWORTH_S_HZ
from imucald.model.written import WrittenModel, read_written
from imucald.model_compensation.terms import (
    NO_RAIL,
    ChassisTerms,
    ScalarTerms,
    SuspensionTerms,
    Terms,
    TriadTerms,
    inverse_gain,
)

RANGES: Mapping[str, tuple[float, float]] = {
    "bias": (-20.0, 20.0),
    "bias_temperature": (-1.0, 1.0),
    "g_sensitivity": (-1.0, 1.0),
    "hard_iron_t": (-0.01, 0.01),
    "offset": (-20.0, 20.0),
    "time_constant_s": (0.0, 2.0),
    "lowpass_hz": (0.01, math.inf),
    # a vehicle whose body leans more than 0.06 rad/(m/s^2) would fall over in a curve
    "squat_gradient": (-0.06, 0.06),
    "dive_gradient": (-0.06, 0.06),
    "roll_gradient": (-0.06, 0.06),
    "pitch_frequency_hz": (0.2, 20.0),
    "roll_frequency_hz": (0.2, 20.0),
    "pitch_damping": (0.02, 5.0),
    "roll_damping": (0.02, 5.0),
    "wheelbase_m": (0.5, 20.0),
    "track_m": (0.3, 5.0),
    "steering_ratio": (1.0, 100.0),
    "understeer_gradient": (-0.1, 0.1),
    "crown_mean": (-0.1, 0.1),
    "bank_rms": (0.0, 0.5),
    "grade_rms": (0.0, 0.5),
}
"""Allowed ranges, in the unit of the key. All usable sensors, vehicles and roads are within these
ranges. These ranges are tighter than the ranges of the schema, because a simulated drive may use
any value.
"""
SCALE_RANGE = (-0.8, 4.0)
"""Range of the scale error of a signal with one component. The lower limit is also valid for a
wheel speed, which has no upper limit."""
MAX_LEVER_M = 30.0
SCALARS = ("speed", *VEHICLE_SIGNALS)
FILTERED = ("accel", "gyro", *VEHICLE_SIGNALS)
DELAYED = (*SCALARS, "accel", "gyro", "wheel_speeds", *FLAGS)
RAIL_WIDTH = 0.001
"""Margin of a clipped value, as a share of the full scale: rounding in another unit must not hide a
clipped value."""
NARROW_HZ = 8.0
"""Corner frequency [Hz] below which a filter removes the vehicle's motion."""


def read_terms(
    model: Path | Mapping[str, Any], name: str = "model"
) -> tuple[Terms, tuple[str, ...]]:
    """Read a model file, or a mapping with its content. Returns its terms and the notes.

    Raises ConfigError with one line for each mistake: file, line, key, reason.
    """
    reader = _Reader(read_written(model, name))
    terms = reader.terms()
    return terms, tuple(reader.notes())


class _Reader:
    def __init__(self, file: WrittenModel) -> None:
        self._file = file

    def terms(self) -> Terms:
        wheels = self._value("wheel_speeds", "scale", (0.0,) * 4)
        if min(wheels) <= SCALE_RANGE[0]:
            self._file.refuse("wheel_speeds", "scale", "is not an error of a wheel speed")
        scalars = {name: self._scalar(name) for name in SCALARS}
        found = Terms(
            accel=self._triad("accel"),
            gyro=self._triad("gyro"),
            g_sensitivity=self._value("gyro", "g_sensitivity", ZERO),
            mag=TriadTerms(bias=self._value("mag", "hard_iron_t", ZERO)),
            wheel_scales=wheels,
            scalars={name: s for name, s in scalars.items() if s != ScalarTerms()},
            lever_arm=self._lever_arm(),
            suspension=self._suspension(),
            latency=self._latency(),
            chassis=ChassisTerms(
                self._value("chassis", "wheelbase_m"),
                self._value("chassis", "track_m"),
                self._value("chassis", "steering_ratio"),
                self._value("chassis", "understeer_gradient"),
            ),
            crown_mean=self._value("road", "crown_mean"),
            bank_rms=self._rms("bank"),
            grade_rms=self._rms("grade"),
        )
        self._file.check()
        return found

    def notes(self) -> list[str]:
        """Return one line for each part of the model file that is not used."""
        file = self._file
        found = [f"{key}: this version does not know it; it is ignored" for key in file.unknown]
        if any(file.is_set("mount", f"{a}_deg") for a in ("roll", "pitch", "yaw")):
            found.append(
                "mount: the angles in the model are not used; the daemon finds them itself"
            )
        if file.is_set("mount", "shifts"):
            found.append(
                "mount.shifts: the shifts in the model are not used; the daemon finds them itself"
            )
        for section in FILTERED:
            corner = self._value(section, "lowpass_hz")
            if corner is not None and corner < NARROW_HZ:
                found.append(
                    f"{section}.lowpass_hz: only the delay of the filter ({corner:g} Hz) is "
                    "corrected; what it removed cannot be restored"
                )
        for section in ("accel", "gyro"):
            if self._value(section, "delay_s", 0.0) > 0.0:
                found.append(
                    f"{section}.delay_s: used to find the mount; the corrected signal is as "
                    "late as that of the sensor"
                )
        for section in file.sections:
            for key in ("dropouts", "stuck", "clock_drift_ppm", "slip_events"):
                if file.is_set(section, key):
                    found.append(f"{section}.{key}: it cannot be corrected")
        if file.is_set("heading", "offset") or file.is_set("heading", "scale"):
            found.append("heading: its errors are not corrected")
        return found

    # sections --------------------------------------------------------------------------------

    def _triad(self, section: str) -> TriadTerms:
        scale = self._value(section, "scale", ZERO)
        inverse = inverse_gain(scale, self._value(section, "cross_axis", (*ZERO, *ZERO)))
        if inverse is None:
            self._file.refuse(section, "scale", "is a gain that cannot be corrected")
            return TriadTerms()
        return TriadTerms(
            inverse,
            self._value(section, "bias", ZERO),
            self._value(section, "bias_temperature", ZERO),
            self._rail(section),
        )

    def _scalar(self, section: str) -> ScalarTerms:
        scale = self._within(section, "scale", self._file.value(section, "scale", 0.0), SCALE_RANGE)
        offset = self._value(section, "offset", 0.0)
        return ScalarTerms(scale or 0.0, offset, self._rail(section))

    def _rail(self, section: str) -> tuple[float, float]:
        """Return the range of the absolute values of clipped raw values. A value above this range
        shows that the sensor does not clip at this limit."""
        full_scale = self._value(section, "full_scale")
        if full_scale is None:
            return NO_RAIL
        width = max(0.51 * self._value(section, "lsb", 0.0), RAIL_WIDTH * full_scale)
        return full_scale - width, full_scale + width

    def _lever_arm(self) -> Vector3:
        if not self._value("mount", "lever_arm", True):
            return ZERO
        arm: Vector3 = self._value("mount", "lever_arm_m", ZERO)
        if math.hypot(*arm) > MAX_LEVER_M:
            self._file.refuse("mount", "lever_arm_m", "is longer than a vehicle")
        return arm

    def _suspension(self) -> SuspensionTerms:
        if not self._file.has("suspension"):
            return SuspensionTerms()

        def gradient(key: str, switch: str) -> float:
            found: float = self._value("suspension", key, 0.0)
            return found if self._value("suspension", switch, True) else 0.0

        springs = SuspensionTerms()
        return SuspensionTerms(
            gradient("squat_gradient", "squat_dive"),
            gradient("dive_gradient", "squat_dive"),
            self._value("suspension", "pitch_frequency_hz", springs.pitch_hz),
            self._value("suspension", "pitch_damping", springs.pitch_damping),
            gradient("roll_gradient", "body_roll"),
            self._value("suspension", "roll_frequency_hz", springs.roll_hz),
            self._value("suspension", "roll_damping", springs.roll_damping),
        )

    def _latency(self) -> dict[str, float]:
        """Return the age [s] of each channel whose age the file states."""
        found: dict[str, float] = {}
        for name in DELAYED:
            if not self._file.has(name, "delay_s", "time_constant_s", "lowpass_hz"):
                continue
            age: float = self._value(name, "delay_s", 0.0)
            age += self._value(name, "time_constant_s", 0.0)
            corner = self._value(name, "lowpass_hz")
            found[name] = age + (0.0 if corner is None else BUTTERWORTH_S_HZ / corner)
        return found

    def _rms(self, name: str) -> float:
        rms: float = self._value("road", f"{name}_rms", 0.0)
        return rms if self._value("road", name, True) else 0.0

    # values ----------------------------------------------------------------------------------

    def _value(self, section: str, key: str, absent: Any = None) -> Any:
        """Return the value of a key within `RANGES`; `absent` if there is no value or a wrong
        value."""
        value = self._file.value(section, key, absent)
        found = self._within(section, key, value, RANGES.get(key))
        return absent if found is None else found

    def _within(
        self, section: str, key: str, value: Any, limits: tuple[float, float] | None
    ) -> Any:
        if value is None or limits is None:
            return value
        low, high = limits
        numbers = value if isinstance(value, tuple) else (value,)
        if all(low <= x <= high for x in numbers):
            return value
        reason = f"must be between {low:g} and {high:g}"
        if high == math.inf:
            reason = f"must be at least {low:g}"
        self._file.refuse(section, key, f"{reason} (here: {', '.join(f'{x:g}' for x in numbers)})")
        return None
