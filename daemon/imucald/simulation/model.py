"""The model file: every parameter of a simulated drive, each effect on or off."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml
from pydantic import Field, ValidationError

from imucald.errors import ConfigError
from imucald.simulation.section import Positive, Section
from imucald.simulation.sensor_model import (
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
from imucald.simulation.vehicle_model import Chassis, Mount, Road, Route, Suspension


class Model(Section):
    """All parameters of a drive but its seed and length. Immutable: see `with_changes`."""

    grid_hz: Positive = Field(default=200.0, ge=50.0, le=2000.0)
    """Rate of the physics; must not be below the fastest sensor's."""
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
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from error
    try:
        data = yaml.safe_load(text)
        node = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.YAMLError as error:
        raise ConfigError(f"{path}: not valid YAML: {error}") from error
    lines: dict[tuple[str, ...], int] = {}
    _collect_lines(node, (), lines)
    return _validated({} if data is None else data, str(path), lines)


def _validated(data: object, place: str, lines: Mapping[tuple[str, ...], int]) -> Model:
    try:
        return Model.model_validate(data)
    except ValidationError as error:
        raise ConfigError(
            "\n".join(
                _describe(place, tuple(str(part) for part in item["loc"]), item["msg"], lines)
                for item in error.errors(include_url=False, include_context=False)
            )
        ) from error


def _describe(
    place: str, key: tuple[str, ...], reason: str, lines: Mapping[tuple[str, ...], int]
) -> str:
    line = next((lines[key[:n]] for n in range(len(key), 0, -1) if key[:n] in lines), None)
    where = place if line is None else f"{place}:{line}"
    return f"{where}: {'.'.join(key) or 'model'}: {reason}"


def _collect_lines(
    node: yaml.Node | None, key: tuple[str, ...], lines: dict[tuple[str, ...], int]
) -> None:
    if isinstance(node, yaml.MappingNode):
        for name, value in node.value:
            path = (*key, str(name.value))
            lines[path] = name.start_mark.line + 1
            _collect_lines(value, path, lines)
    elif isinstance(node, yaml.SequenceNode):
        for i, value in enumerate(node.value):
            path = (*key, str(i))
            lines[path] = value.start_mark.line + 1
            _collect_lines(value, path, lines)
