"""The model file: all parameters of a simulated drive. Each effect can be on or off.

Only this module reads, validates, changes and writes the complete file. `written` reads the same
file for use while driving, without defaults for missing keys.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from imucald.core.errors import ConfigError
from imucald.core.typed import Document, typed
from imucald.core.yaml_lines import read_yaml_file
from imucald.model.leaves import Leaves
from imucald.model.section import NonNegative, Section, plain
from imucald.model.sensors import (
    Accelerometer,
    BusLoad,
    Flag,
    Gyroscope,
    Heading,
    LateralAccel,
    LongitudinalAccel,
    Magnetometer,
    Speed,
    Steering,
    Temperature,
    WheelSpeeds,
    YawRate,
)
from imucald.model.vehicle import Chassis, DriveRoute, Mount, Road, Suspension

WHOLE = "model file"
"""Name of the model file in error texts without a key."""


class VehicleModel(Section, frozen=True):
    """All parameters of a drive except its seed and duration. The object is immutable, see
    `with_changes`."""

    grid_hz: Annotated[float, Meta(ge=50.0, le=2000.0)] = 200.0
    """Rate of the simulated physics [Hz]. This rate must be at least the rate of the inertial
    sensor."""
    route: DriveRoute = DriveRoute()
    chassis: Chassis = Chassis()
    suspension: Suspension = Suspension()
    road: Road = Road()
    mount: Mount = Mount()
    accel: Accelerometer = Accelerometer()
    gyro: Gyroscope = Gyroscope()
    speed: Speed = Speed()
    wheel_speeds: WheelSpeeds = WheelSpeeds()
    steering: Steering = Steering()
    yaw_rate: YawRate = YawRate()
    lateral_accel: LateralAccel = LateralAccel()
    longitudinal_accel: LongitudinalAccel = LongitudinalAccel()
    reverse: Flag = Flag()
    brake: Flag = Flag()
    heading: Heading = Heading()
    mag: Magnetometer = Magnetometer()
    temperature: Temperature = Temperature()
    bus: BusLoad = BusLoad()
    known_to: dict[str, NonNegative] = msgspec.field(default_factory=dict)
    """Half widths within which numbers of this file are correct, by the keys of `imucald diagnose`,
    in SI units. For all other numbers, the tolerances of the catalogue of `imucald diagnose` apply.
    """
    leaves: dict[str, Leaves] = msgspec.field(default_factory=dict)
    """Residuals of the drives from which this file was made, by equation of `imucald diagnose`, and
    statistics of the signals of these drives (`imucald.model.leaves`)."""

    def __post_init__(self) -> None:
        fastest = max(self.accel.rate_hz, self.gyro.rate_hz)
        if self.grid_hz < fastest:
            raise ValueError(
                f"grid_hz must be at least the rate of the inertial sensor, {fastest:g}"
            )

    def dump(self) -> dict[str, Any]:
        """Return every key and its value as plain data (mappings, lists, numbers, texts)."""
        data: dict[str, Any] = plain(msgspec.to_builtins(self))
        return data

    def to_yaml(self) -> str:
        """Return the model as the text of a model file."""
        import yaml  # noqa: PLC0415 - only who writes a file needs it

        return yaml.safe_dump(self.dump(), sort_keys=False)

    def with_changes(self, changes: Mapping[str, Any]) -> VehicleModel:
        """Return a copy with other values of dotted keys, such as ``{"mount.yaw_deg": 30.0}``.

        Raises ConfigError for an unknown key or a value out of its range.
        """
        data = self.dump()
        for key, value in changes.items():
            *parents, last = key.split(".")
            place: Any = data
            for name in parents:
                place = place.get(name) if isinstance(place, dict) else None
            if not isinstance(place, dict) or last not in place:
                raise ConfigError(f"model: there is no parameter {key!r}{_near(key, self.dump())}")
            place[last] = value
        return model_from_mapping(data, "model")


def _near(key: str, data: Mapping[str, Any]) -> str:
    """Return a text with names similar to an unknown key, and with the command that lists all
    keys."""
    import difflib  # noqa: PLC0415 - only for a mistake

    near = difflib.get_close_matches(key, list(_dotted(data)), n=3)
    hint = f"; did you mean {' or '.join(near)}?" if near else ";"
    return f"{hint} 'imucald simulate --write-model FILE' lists all parameters"


def _dotted(data: Mapping[str, Any], above: str = "") -> Iterator[str]:
    for name, value in data.items():
        if isinstance(value, Mapping):
            yield from _dotted(value, f"{above}{name}.")
        else:
            yield f"{above}{name}"


def model_from_mapping(data: Mapping[str, Any], name: str) -> VehicleModel:
    """Return the model that a mapping (parsed YAML) describes. Raises ConfigError with all
    mistakes.

    name: name of the model in texts.
    """
    return typed(plain(data), VehicleModel, Document(name, {}, WHOLE))


def load_model(path: Path | str) -> VehicleModel:
    """Read a model file. Missing keys have their default values.

    Raises ConfigError with one line for each mistake: file, line, key, reason, remedy.
    """
    data, marks = read_yaml_file(Path(path), WHOLE)
    return typed({} if data is None else data, VehicleModel, Document(str(path), marks, WHOLE))
