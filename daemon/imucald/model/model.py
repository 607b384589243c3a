"""The model file: every parameter of a simulated drive, each effect on or off."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml
from pydantic import Field, ValidationError, model_validator

from imucald.core.errors import ConfigError
from imucald.core.locations import Marks
from imucald.core.yaml_lines import MAX_FILE_BYTES, read_yaml
from imucald.model.section import Positive, Section
from imucald.model.sensors import (
    Accelerometer,
    Bus,
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
from imucald.model.vehicle import Chassis, Mount, Road, Route, Suspension


class Model(Section):
    """All parameters of a drive but its seed and length. Immutable: see `with_changes`."""

    grid_hz: Positive = Field(default=200.0, ge=50.0, le=2000.0)
    """Rate of the physics; must not be below the inertial sensor's."""
    route: Route = Route()
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
    bus: Bus = Bus()

    @model_validator(mode="after")
    def _fine_enough(self) -> Model:
        fastest = max(self.accel.rate_hz, self.gyro.rate_hz)
        if self.grid_hz < fastest:
            raise ValueError(f"grid_hz must be at least the inertial sensor's rate, {fastest:g}")
        return self

    def to_yaml(self) -> str:
        """Return the model as the text of a model file."""
        return yaml.safe_dump(self.model_dump(mode="json"), sort_keys=False)

    def with_changes(self, changes: Mapping[str, Any]) -> Model:
        """Return a copy with dotted keys replaced, as ``{"mount.yaw_deg": 30.0}``.

        Raises ConfigError for an unknown key or a value out of its range.
        """
        data = self.model_dump()
        for key, value in changes.items():
            *parents, last = key.split(".")
            place: Any = data
            for name in parents:
                place = place.get(name) if isinstance(place, dict) else None
            if not isinstance(place, dict) or last not in place:
                raise ConfigError(f"model: there is no parameter {key!r}")
            place[last] = value
        return model_from_mapping(data, "model")


def model_from_mapping(data: object, place: str) -> Model:
    """Return the model that a mapping (parsed YAML) describes; ConfigError names each mistake."""
    return _validated(data, place, {})


def load_model(path: Path | str) -> Model:
    """Read a model file. Raises ConfigError with file, line, key and reason."""
    try:
        size = Path(path).stat().st_size
        if size > MAX_FILE_BYTES:
            raise ConfigError(f"{path}: {size} bytes is too long for a model file")
        text = Path(path).read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: is not UTF-8 text: {error.reason}") from None
    data, marks = read_yaml(text, str(path))
    return _validated({} if data is None else data, str(path), marks)


def _validated(data: object, place: str, marks: Marks) -> Model:
    try:
        return Model.model_validate(data)
    except ValidationError as error:
        lines = [
            _describe(place, item["loc"], item["msg"], marks)
            for item in error.errors(include_url=False, include_context=False)
        ]
        raise ConfigError("\n".join(lines)) from None


def _describe(place: str, key: tuple[str | int, ...], reason: str, marks: Marks) -> str:
    known = next((key[:n] for n in range(len(key), 0, -1) if key[:n] in marks), None)
    where = place if known is None else f"{place}:{marks[known]}"
    name = ".".join(str(part) for part in key) or "model"
    reason = reason.removeprefix("Value error, ").replace("Extra inputs are not permitted",
                                                          "unknown key; leave it out")  # fmt: skip
    return f"{where}: {name}: {reason[:1].lower()}{reason[1:]}"
