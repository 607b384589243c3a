"""Read and check a complete configuration. The place of each key in the file is stored for error
texts."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from imucald.config.attitude import AttitudeSettings, TravelDirectionSettings
from imucald.config.base import Settings
from imucald.config.calibration import CalibrationSettings
from imucald.config.network import (
    BusSettings,
    Databases,
    DatabaseSettings,
    MessageProtection,
    Output,
    Uds,
)
from imucald.config.signals import Signals, spelled_out
from imucald.config.vehicle import ModelFile, VehicleSettings
from imucald.config.without_effect import idle_keys, impossible
from imucald.core.errors import ConfigError
from imucald.core.typed import Document, Marks, Place, typed
from imucald.core.yaml_lines import read_yaml, read_yaml_file

_WHOLE = "configuration"
_DATABASES = frozenset({".dbc", ".arxml", ".kcd", ".sym"})


class Config(Settings, frozen=True, kw_only=True):
    """A whole configuration file."""

    vehicle: VehicleSettings = VehicleSettings()
    model: ModelFile | None = None
    database: Databases
    signals: Signals
    messages: dict[str, MessageProtection] = msgspec.field(default_factory=dict)
    bus: BusSettings = BusSettings()
    calibration: CalibrationSettings = CalibrationSettings()
    output: Output = Output()
    attitude: AttitudeSettings = AttitudeSettings()
    travel_direction: TravelDirectionSettings = TravelDirectionSettings()
    diagnostics: Uds = Uds()

    def __post_init__(self) -> None:
        """Set the defaults of keys that depend on other keys."""
        calibration, attitude = self.calibration, self.attitude
        compensation, of_filter = attitude.compensation, attitude.filter
        if compensation.delay is None:
            delay = calibration.speed_delay or 0.0
            compensation = msgspec.structs.replace(compensation, delay=delay)
        if of_filter.accel_random is None:
            random = calibration.accelerometer_bias
            of_filter = msgspec.structs.replace(of_filter, accel_random=random)
        attitude = msgspec.structs.replace(attitude, compensation=compensation, filter=of_filter)
        msgspec.structs.force_setattr(self, "attitude", attitude)

    @property
    def uses_method_a(self) -> bool:
        """True if method A alone finds the mount.

        The result is True if method A is configured, or if there is neither a speed nor a turn
        rate. Without both, the joint estimator cannot distinguish forward from backward.
        """
        signals = self.signals
        has_speed = signals.speed is not None or signals.wheel_speeds is not None
        turns = signals.gyroscope, signals.yaw_rate, signals.steering_wheel_angle
        is_shown = any(turns) and signals.accelerometer[0].z is not None
        return self.calibration.estimator == "published" or not (has_speed or is_shown)


class LoadedConfig:
    """A configuration with its origin.

    config: the settings. path: the file, or None. marks: the position of each key in the file.
    """

    def __init__(self, config: Config, path: Path | None, marks: Marks) -> None:
        self.config = config
        self.path = path
        self._marks = marks
        self._document = Document(_name(path), marks, _WHOLE)

    def database_path(self, database: DatabaseSettings) -> Path:
        """Return the absolute path of a database. A relative path starts at the folder of the
        configuration file."""
        return self._resolved(database.path)

    @property
    def model_path(self) -> Path | None:
        """Absolute path of the model file; None if there is none."""
        model = self.config.model
        return None if model is None else self._resolved(model.path)

    def _resolved(self, path: str) -> Path:
        base = self.path.parent if self.path is not None else Path.cwd()
        try:
            return (base / path).resolve()
        except (OSError, RuntimeError, ValueError) as error:  # a loop of links, a NUL in the name
            raise ConfigError(
                f"{_name(self.path)}: {path!r} is not a valid path: {error}"
            ) from None

    def with_databases(self, entries: tuple[DatabaseSettings, ...]) -> LoadedConfig:
        """Return the same configuration with other database entries."""
        config = msgspec.structs.replace(self.config, database=entries)
        return LoadedConfig(config, self.path, self._marks)

    def keys_in(self, section: str) -> frozenset[str]:
        """Return the keys of a section that are present in the file."""
        places = (place for place in self._marks if len(place) == 2 and place[0] == section)
        return frozenset(str(place[1]) for place in places)

    def with_model(self, path: Path) -> LoadedConfig:
        """Return the same configuration with another path of the model file."""
        if self.config.model is None:
            raise self.error(
                ("model",),
                "the configuration names no model file, so the path of the model file cannot be "
                "changed",
            )
        model = msgspec.structs.replace(self.config.model, path=str(path.resolve()))
        config = msgspec.structs.replace(self.config, model=model)
        return LoadedConfig(config, self.path, self._marks)

    def idle_keys(self) -> list[str]:
        """Return one line for each key without effect, with its place and the reason."""
        return [
            f"{self._document.located(place)}: {why}"
            for place, why in idle_keys(self.config, lambda place: place in self._marks)
        ]

    def error(self, place: Place, text: str) -> ConfigError:
        """Return an error for a key of the file, such as ("signals", "speed", 0)."""
        written: Place = ()
        for part in place:  # a single source is allowed instead of a list
            if not isinstance(part, int) or (*written, part) in self._marks:
                written = (*written, part)
        return ConfigError(f"{self._document.located(written)}: {text}")


def load_config(path: Path) -> LoadedConfig:
    """Read a configuration file.

    Raises ConfigError with one line per mistake: file, line, key, reason, remedy.
    """
    if path.suffix.lower() in _DATABASES and path.is_file():
        raise ConfigError(
            f"{path}: this is a CAN database; give the configuration (YAML) that names it "
            f"under 'database:' ('imucald init --database {path} LOG' proposes a "
            "configuration)"
        )
    data, marks = read_yaml_file(path, _WHOLE)
    return _checked(data, marks, path)


def parse_config(text: str, path: Path | None = None) -> LoadedConfig:
    """Parse the text of a configuration. Relative paths start at the folder of `path`.

    Raises ConfigError as `load_config` does. The errors name `path`.
    """
    return _checked(*read_yaml(text, _name(path)), path)


def _checked(data: Any, marks: Marks, path: Path | None) -> LoadedConfig:
    name = _name(path)
    if not isinstance(data, dict):
        empty = "the file is empty; " if data is None else ""
        raise ConfigError(
            f"{name}:1: {empty}a configuration is a mapping with 'database' and 'signals' "
            "('imucald init' proposes one)"
        )
    config = typed(data, Config, Document(name, marks, _WHOLE), full=spelled_out(data))
    loaded = LoadedConfig(config, path, marks)
    mistakes = [str(loaded.error(place, text)) for place, text in impossible(config)]
    if mistakes:
        raise ConfigError("\n".join(mistakes))
    return loaded


def _name(path: Path | None) -> str:
    return "<config>" if path is None else str(path)


def json_schema(choices: Mapping[tuple[str, str], Sequence[str]] | None = None) -> str:
    """Return the JSON schema (draft 7) of the configuration; choices: see `described_schema`."""
    from imucald.config.schema import described_schema  # noqa: PLC0415 - only for this

    return json.dumps(described_schema(Config, choices or {}), indent=2)


def example_path() -> Path:
    """Return the path of the configuration for the example bus (``imucald_example.dbc``)."""
    return Path(__file__).parent.parent / "data" / "imucald_example.yaml"
