"""A whole configuration: read, checked, and where it came from."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec

from imucald.config.attitude import Attitude, TravelDirection
from imucald.config.base import Model
from imucald.config.calibration import Calibration
from imucald.config.network import (
    Bus,
    Database,
    Databases,
    MessageProtection,
    ModelFile,
    Output,
    Vehicle,
)
from imucald.config.shorthand import spelled_out
from imucald.config.signals import Signals
from imucald.config.uds import Diagnostics
from imucald.config.yaml_lines import (
    MAX_FILE_BYTES,
    Marks,
    Place,
    dotted,
    infinite_places,
    line_of,
    read_yaml,
)
from imucald.core.errors import ConfigError


class Config(Model, frozen=True, kw_only=True):
    """A whole configuration file."""

    vehicle: Vehicle = Vehicle()
    model: ModelFile | None = None
    database: Databases
    signals: Signals
    messages: dict[str, MessageProtection] = msgspec.field(default_factory=dict)
    bus: Bus = Bus()
    calibration: Calibration = Calibration()
    output: Output = Output()
    attitude: Attitude = Attitude()
    travel_direction: TravelDirection = TravelDirection()
    diagnostics: Diagnostics = Diagnostics()


class LoadedConfig:
    """A configuration with the place it came from.

    config: the settings. path: the file, or None. `database_paths`: absolute.
    """

    def __init__(self, config: Config, path: Path | None, marks: Marks) -> None:
        self.config = config
        self.path = path
        self._marks = marks

    def database_path(self, database: Database) -> Path:
        """Return a database's absolute path: relative ones are relative to the configuration."""
        return self._resolved(database.path)

    @property
    def model_path(self) -> Path | None:
        """Absolute path of the model file, where there is one."""
        model = self.config.model
        return None if model is None else self._resolved(model.path)

    def _resolved(self, path: str) -> Path:
        base = self.path.parent if self.path is not None else Path.cwd()
        return (base / path).resolve()

    def with_databases(self, entries: tuple[Database, ...]) -> LoadedConfig:
        """The same configuration with other database entries."""
        config = msgspec.structs.replace(self.config, database=entries)
        return LoadedConfig(config, self.path, self._marks)

    def error(self, place: Place, text: str) -> ConfigError:
        """An error at a key of the file, such as ("signals", "speed", 0)."""
        written: Place = ()
        for part in place:  # a single source may stand where a list of them is meant
            if not isinstance(part, int) or (*written, part) in self._marks:
                written = (*written, part)
        name = str(self.path) if self.path is not None else "<config>"
        return ConfigError(f"{name}:{line_of(self._marks, written)}: {dotted(written)}: {text}")


def load_config(path: Path) -> LoadedConfig:
    """Read a configuration file.

    Raises ConfigError with one line per mistake: file, line, key, reason, remedy.
    """
    try:
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise ConfigError(f"{path}: {size} bytes is too long for a configuration")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: is not UTF-8 text: {error.reason}") from None
    return parse_config(text, path)


def parse_config(text: str, path: Path | None = None) -> LoadedConfig:
    """Parse the text of a configuration; `path` names it and anchors relative paths.

    Raises ConfigError as `load_config` does.
    """
    name = str(path) if path is not None else "<config>"
    data, marks = read_yaml(text, name)
    if not isinstance(data, dict):
        raise ConfigError(f"{name}:1: a configuration is a mapping with 'database' and 'signals'")
    infinite = [
        f"{name}:{line_of(marks, place)}: {dotted(place)}: must be a finite number"
        for place in infinite_places(data)
    ]
    if infinite:
        raise ConfigError("\n".join(infinite))
    full = spelled_out(data)
    try:
        config = msgspec.convert(full, Config)
    except (ValueError, OverflowError) as error:  # msgspec.ValidationError is a ValueError
        from imucald.config.explain import explain  # noqa: PLC0415 - a lighter start without

        lines = list(explain(data, full, Config, marks, name)) or [f"{name}:1: {error}"]
        raise ConfigError("\n".join(lines)) from None
    return LoadedConfig(config, path, marks)


def json_schema() -> str:
    """JSON schema (draft 2020-12) of the configuration."""
    from imucald.config.schema import described_schema  # noqa: PLC0415 - only for this

    return json.dumps(described_schema(Config), indent=2)
