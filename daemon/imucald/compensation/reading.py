"""A model file -> terms, and a line for each part of it that cannot be had while driving.

Only what is used is looked at, and by hand: the simulation's own types would bring all that a
simulated drive needs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from imucald.compensation.known_keys import KNOWN, OTHERS
from imucald.compensation.terms import (
    BUTTERWORTH_DELAY,
    NO_RAIL,
    ZERO,
    ChassisTerms,
    LeanTerms,
    ScalarTerms,
    Terms,
    TriadTerms,
    Vector3,
    inverse_gain,
)
from imucald.core.errors import ConfigError
from imucald.core.locations import Marks, dotted, line_of
from imucald.core.yaml_lines import MAX_FILE_BYTES, read_yaml

LARGEST = {"bias": 20.0, "bias_temperature": 1.0, "g_sensitivity": 1.0, "hard_iron_t": 0.01}
"""Beyond any sensor that is worth correcting, in the unit of the key."""
LONGEST_LEVER_M = 30.0
STEEPEST_ROADS = 0.5
STEEPEST_LEAN = 0.06
"""A body that leans so much [rad/(m/s^2)] would fall over in a curve."""
LONGEST_DELAY_S = 2.0
SCALARS = ("speed", "steering", "yaw_rate", "lateral_accel", "longitudinal_accel")
FILTERED = ("accel", "gyro", "steering", "yaw_rate", "lateral_accel", "longitudinal_accel")
RAIL_WIDTH = 0.001
"""Part of the full scale: other units' rounding must not hide a clipped value."""
NARROW_HZ = 8.0
"""A filter with a lower corner takes away what a vehicle does."""


def load_terms(path: Path) -> tuple[Terms, tuple[str, ...]]:
    """Read a model file: its terms, and notes. Raises ConfigError with file, line, key, reason."""
    try:
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise ConfigError(f"{path}: {size} bytes is too long for a model file")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: is not UTF-8 text: {error.reason}") from None
    data, marks = read_yaml(text, str(path))
    return read_terms(data, str(path), marks)


def read_terms(data: Any, name: str, marks: Marks) -> tuple[Terms, tuple[str, ...]]:
    """The same of parsed YAML; `name` and `marks` say where a mistake stands."""
    if data is None:
        data = {}
    reader = _Reader(data, name, marks)
    terms = reader.terms()
    return terms, tuple(reader.notes)


class _Reader:
    def __init__(self, data: Any, name: str, marks: Marks) -> None:
        self.notes: list[str] = []
        self._name, self._marks = name, marks
        if not isinstance(data, Mapping):
            raise ConfigError(f"{name}:1: a model file is a mapping of sections")
        self._data: dict[str, Mapping[str, Any]] = {}
        for section, content in data.items():
            if section in OTHERS:
                continue
            if section not in KNOWN:
                self.notes.append(f"{section}: is not known to this version, ignored")
                continue
            if not isinstance(content, Mapping):
                raise self._error((section,), "is a mapping of keys")
            self._data[section] = content
            for key in content:
                if key not in KNOWN[section]:
                    text = f"{section}.{key}: is not known to this version, ignored"
                    self.notes.append(text)

    def terms(self) -> Terms:
        wheels = self._numbers("wheel_speeds", "scale", 4, (0.0,) * 4)
        scalars = {name: self._scalar(name) for name in SCALARS}
        if any(w <= -0.8 for w in wheels):
            raise self._error(("wheel_speeds", "scale"), "is no error of a wheel speed")
        found = Terms(
            accel=self._triad("accel"),
            gyro=self._triad("gyro"),
            g_sensitivity=self._vector("gyro", "g_sensitivity"),
            mag=TriadTerms(bias=self._vector("mag", "hard_iron_t")),
            wheel_scales=(wheels[0], wheels[1], wheels[2], wheels[3]),
            scalars={name: s for name, s in scalars.items() if s != ScalarTerms()},
            lever_arm=self._lever_arm(),
            lean=self._lean(),
            lateness=self._lateness(),
            chassis=self._chassis(),
            crown_mean=self._optional("road", "crown_mean", -0.1, 0.1),
            bank_rms=self._rms("bank"),
            grade_rms=self._rms("grade"),
        )
        self._note_what_is_left()
        return found

    # sections --------------------------------------------------------------------------------

    def _triad(self, section: str) -> TriadTerms:
        scale = self._vector(section, "scale")
        inverse = inverse_gain(scale, self._numbers(section, "cross_axis", 6, (0.0,) * 6))
        if inverse is None:
            raise self._error((section, "scale"), "is no gain that can be undone")
        return TriadTerms(
            inverse,
            self._vector(section, "bias"),
            self._vector(section, "bias_temperature"),
            self._rail(section),
        )

    def _scalar(self, section: str) -> ScalarTerms:
        scale = self._number(section, "scale", 0.0, -0.8, 4.0)
        offset = 0.0 if section == "speed" else self._number(section, "offset", 0.0, -20.0, 20.0)
        return ScalarTerms(scale, offset, self._rail(section))

    def _rail(self, section: str) -> tuple[float, float]:
        """Sizes of raw values that were clipped; one beyond shows that there is no rail here."""
        known = "full_scale" in KNOWN[section]
        full_scale = self._optional(section, "full_scale", 0.0, math.inf) if known else None
        if not full_scale:
            return NO_RAIL
        step = self._number(section, "lsb", 0.0, 0.0, math.inf)
        width = max(0.51 * step, RAIL_WIDTH * full_scale)
        return full_scale - width, full_scale + width

    def _lever_arm(self) -> Vector3:
        if not self._on("mount", "lever_arm"):
            return ZERO
        arm = self._vector("mount", "lever_arm_m")
        if math.hypot(*arm) > LONGEST_LEVER_M:
            raise self._error(("mount", "lever_arm_m"), "is longer than a vehicle")
        return arm

    def _lean(self) -> LeanTerms:
        suspension = "suspension"
        if suspension not in self._data:
            return LeanTerms()
        pitches, rolls = self._on(suspension, "squat_dive"), self._on(suspension, "body_roll")

        def gradient(key: str, on: bool) -> float:
            value = self._number(suspension, key, 0.0, -STEEPEST_LEAN, STEEPEST_LEAN)
            return value if on else 0.0

        return LeanTerms(
            gradient("squat_gradient", pitches),
            gradient("dive_gradient", pitches),
            self._number(suspension, "pitch_frequency_hz", 1.7, 0.2, 20.0),
            self._number(suspension, "pitch_damping", 0.35, 0.02, 5.0),
            gradient("roll_gradient", rolls),
            self._number(suspension, "roll_frequency_hz", 1.8, 0.2, 20.0),
            self._number(suspension, "roll_damping", 0.35, 0.02, 5.0),
        )

    def _lateness(self) -> dict[str, float]:
        found: dict[str, float] = {}
        for name in (*SCALARS, "accel", "gyro", "wheel_speeds", "reverse", "brake"):
            said = self._data.get(name, {})
            if not said.keys() & {"delay_s", "time_constant_s", "lowpass_hz"}:
                continue
            late = self._number(name, "delay_s", 0.0, 0.0, LONGEST_DELAY_S)
            if name == "speed":
                late += self._number(name, "time_constant_s", 0.0, 0.0, LONGEST_DELAY_S)
            corner = self._optional(name, "lowpass_hz", 0.01, math.inf)
            late += 0.0 if corner is None else BUTTERWORTH_DELAY / corner
            found[name] = late
        return found

    def _chassis(self) -> ChassisTerms:
        return ChassisTerms(
            self._optional("chassis", "wheelbase_m", 0.5, 20.0),
            self._optional("chassis", "track_m", 0.3, 5.0),
            self._optional("chassis", "steering_ratio", 1.0, 100.0),
            self._optional("chassis", "understeer_gradient", -0.1, 0.1),
        )

    def _rms(self, name: str) -> float:
        rms = self._number("road", f"{name}_rms", 0.0, 0.0, STEEPEST_ROADS)
        return rms if self._on("road", name) else 0.0

    def _note_what_is_left(self) -> None:
        """Say what of the model the daemon can do nothing about."""
        if any(self._data.get("mount", {}).get(f"{a}_deg") for a in ("roll", "pitch", "yaw")):
            self.notes.append("mount: is found while driving, the model's angles are not used")
        if self._data.get("mount", {}).get("shifts"):
            self.notes.append("mount.shifts: are found while driving, the model's are not used")
        for section in FILTERED:
            corner = self._optional(section, "lowpass_hz", 0.01, math.inf)
            if corner is not None and corner < NARROW_HZ:
                self.notes.append(
                    f"{section}.lowpass_hz: what a filter of {corner:g} Hz took away does not "
                    "come back; only its delay is known"
                )
        for section in ("accel", "gyro"):
            if self._number(section, "delay_s", 0.0, 0.0, LONGEST_DELAY_S) > 0.0:
                self.notes.append(
                    f"{section}.delay_s: is used to find the mount; the corrected signal stays "
                    "as late as the sensor's"
                )
        for section, keys in self._data.items():
            for key in ("dropouts", "stuck", "clock_drift_ppm", "slip_events"):
                if keys.get(key):
                    self.notes.append(f"{section}.{key}: nothing can be done about it")
        heading = self._data.get("heading", {})
        if any(heading.get(key) for key in ("offset", "scale")):
            self.notes.append("heading: its errors are not taken out")

    # values ----------------------------------------------------------------------------------

    def _error(self, place: tuple[str, ...], text: str) -> ConfigError:
        line = line_of(self._marks, place)
        where = f"{self._name}:{line}" if self._marks else self._name
        return ConfigError(f"{where}: {dotted(place)}: {text}")

    def _on(self, section: str, key: str) -> bool:
        value = self._data.get(section, {}).get(key, True)
        if not isinstance(value, bool):
            raise self._error((section, key), f"is true or false (here: {value!r})")
        return value

    def _optional(self, section: str, key: str, low: float, high: float) -> float | None:
        if self._data.get(section, {}).get(key) is None:
            return None
        return self._number(section, key, 0.0, low, high)

    def _number(self, section: str, key: str, preset: float, low: float, high: float) -> float:
        value = self._data.get(section, {}).get(key, preset)
        return self._checked((section, key), value, low, high)

    def _vector(self, section: str, key: str) -> Vector3:
        x, y, z = self._numbers(section, key, 3, ZERO)
        return x, y, z

    def _numbers(
        self, section: str, key: str, count: int, preset: tuple[float, ...]
    ) -> tuple[float, ...]:
        values = self._data.get(section, {}).get(key, preset)
        if not isinstance(values, Sequence) or isinstance(values, str) or len(values) != count:
            raise self._error((section, key), f"is a list of {count} numbers")
        most = LARGEST.get(key, math.inf)
        return tuple(self._checked((section, key), v, -most, most) for v in values)

    def _checked(self, place: tuple[str, ...], value: Any, low: float, high: float) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self._error(place, f"is a number (here: {value!r})")
        number = float(value)
        if not (math.isfinite(number) and low <= number <= high):
            raise self._error(place, f"must be between {low:g} and {high:g} (here: {value!r})")
        return number
