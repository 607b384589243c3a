"""fleet.yaml: the addresses of the logs, the rule for the vehicle of each log, and the
configuration for the evaluation."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from imucald.config.base import Settings
from imucald.core.errors import ConfigError
from imucald.core.typed import Document, typed
from imucald.core.yaml_lines import read_yaml_file
from imucald.fleet.bundle import Bundle, bundle_of

_WHOLE = "fleet file"
COLUMNS = ("type", "sensor_serial", "sensor_batch", "firmware")


class FleetSettings(Settings, frozen=True, kw_only=True):
    """The content of fleet.yaml."""

    logs: str | tuple[str, ...]
    """Addresses of logs with wildcards (`**` for folders of any depth), or files with lists of logs
    (.csv or .txt)."""
    config: str
    """Configuration for all vehicles whose type is not in `configs`."""
    configs: dict[str, str] = msgspec.field(default_factory=dict)
    """Configuration by vehicle type."""
    path: str = r"(?P<vehicle>[^/]+)/[^/]+$"
    """Regular expression for the address, with the group (?P<vehicle>...) and optional groups
    (?P<date>...) and (?P<type>...). By default, the name of the log's folder is the vehicle."""
    vehicles: str | None = None
    """CSV with the columns vehicle, type, sensor_serial, sensor_batch, firmware, from, to."""
    storage: dict[str, dict[str, Any]] = msgspec.field(default_factory=dict)
    """Options of file systems by protocol. Secrets are read from environment variables."""


class VehicleFacts(msgspec.Struct, frozen=True):
    """One row of the list of vehicles, valid from one day to another (ISO dates, or empty)."""

    vehicle: str
    values: dict[str, str]
    since: str = ""
    until: str = ""


class Fleet:
    """A fleet file that was read and checked.

    settings: content of the file. bundles: configurations by bundle name.
    """

    def __init__(self, settings: FleetSettings, path: Path, document: Document) -> None:
        """Check the file. Raises ConfigError with place and remedy."""
        self.settings = settings
        self._document = document
        self.folder = path.parent.resolve()
        try:
            self._rule = re.compile(settings.path)
        except re.error as error:
            raise self._error("path", f"is not a valid regular expression: {error}") from None
        if "vehicle" not in self._rule.groupindex:
            raise self._error("path", "needs a group (?P<vehicle>...)")
        self._facts = self._read_vehicles()
        self.default, *others = (
            bundle_of(self.folder / name) for name in (settings.config, *settings.configs.values())
        )
        self._by_type = dict(zip(settings.configs, others, strict=True))
        self.bundles: dict[str, Bundle] = {b.name: b for b in (self.default, *others)}

    def _error(self, key: str, text: str) -> ConfigError:
        return ConfigError(f"{self._document.located((key,))}: {text}")

    def _read_vehicles(self) -> dict[str, list[VehicleFacts]]:
        if self.settings.vehicles is None:
            return {}
        path = self.folder / self.settings.vehicles
        try:
            with path.open(newline="", encoding="utf-8-sig") as file:
                rows = list(csv.DictReader(file))
        except (OSError, UnicodeDecodeError, csv.Error) as error:
            raise self._error("vehicles", f"{path}: cannot be read: {error}") from None
        if rows and "vehicle" not in rows[0]:
            raise self._error("vehicles", f"{path}: has no column 'vehicle'")
        found: dict[str, list[VehicleFacts]] = {}
        for row in rows:
            values = {name: row[name] for name in COLUMNS if row.get(name)}
            facts = VehicleFacts(row["vehicle"], values, row.get("from") or "", row.get("to") or "")
            found.setdefault(facts.vehicle, []).append(facts)
        return found

    def named(self, source: str) -> tuple[str, str | None, str | None]:
        """Return vehicle, day (ISO) and vehicle type from the address of a log. If the rule does
        not match, the vehicle is the address itself."""
        match = self._rule.search(source)
        if match is None:
            return source, None, None
        groups = match.groupdict()
        return groups["vehicle"], iso_day(groups.get("date")), groups.get("type")

    def facts(self, vehicle: str, day: str | None) -> dict[str, str]:
        """Return type, serial number, batch and firmware of a vehicle on a day."""
        rows = self._facts.get(vehicle, [])
        for row in rows:
            if day is None or (row.since or day) <= day <= (row.until or day):
                return row.values
        return {}

    def bundle(self, vehicle_type: str | None) -> Bundle:
        """Return the configuration of a vehicle type."""
        return self._by_type.get(vehicle_type or "", self.default)


def iso_day(text: str | None) -> str | None:
    """Convert a day in any common notation to YYYY-MM-DD; None if the text is not a day."""
    match = re.search(r"(\d{4})[-_/.]?(\d\d)[-_/.]?(\d\d)", text or "")
    return "-".join(match.groups()) if match else None


def load_fleet(path: Path, changes: Mapping[str, Any] | None = None) -> Fleet:
    """Read a fleet file. changes: values from the command line, by key. Raises ConfigError."""
    settings, document = read_settings(path, changes)
    return Fleet(settings, path, document)


def read_settings(
    path: Path, changes: Mapping[str, Any] | None = None
) -> tuple[FleetSettings, Document]:
    """Return the settings of a fleet file, without reading the files that it names. Raises
    ConfigError."""
    data, marks = read_yaml_file(path, _WHOLE)
    if not isinstance(data, dict):
        raise ConfigError(f"{path}:1: a fleet file is a mapping with 'logs' and 'config'")
    data = data | dict(changes or {})
    document = Document(str(path), marks, _WHOLE)
    return typed(data, FleetSettings, document), document


def patterns(settings: FleetSettings) -> Sequence[str]:
    """Return the addresses of the logs, always as a list."""
    return (settings.logs,) if isinstance(settings.logs, str) else settings.logs
