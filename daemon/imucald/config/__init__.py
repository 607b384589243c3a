"""Read YAML files into typed settings. Each mistake gives one line with its place and a remedy.

The settings in this package define the configuration reference. `imucald schema` prints their JSON
schema, and ``docs/configuration.md`` is checked against them. Files are untrusted: limits of size,
nesting and aliases are checked before any setting is created.
"""

from __future__ import annotations

from imucald.config.base import EXTENDED_ID_MAX, STANDARD_ID_MAX
from imucald.config.calibration import CalibrationSettings
from imucald.config.network import (
    BusSettings,
    ChecksumSettings,
    Counter,
    DatabaseSettings,
    MessageProtection,
    Output,
    OutputIds,
)
from imucald.config.root import Config, LoadedConfig, json_schema, load_config, parse_config
from imucald.config.signals import (
    ParallelSensor,
    RawSource,
    Signals,
    SourceSettings,
    TriadSettings,
    ValidWhen,
    Wheels,
)
from imucald.config.vehicle import VehicleSettings

__all__ = [
    "EXTENDED_ID_MAX",
    "STANDARD_ID_MAX",
    "BusSettings",
    "CalibrationSettings",
    "ChecksumSettings",
    "Config",
    "Counter",
    "DatabaseSettings",
    "LoadedConfig",
    "MessageProtection",
    "Output",
    "OutputIds",
    "ParallelSensor",
    "RawSource",
    "Signals",
    "SourceSettings",
    "TriadSettings",
    "ValidWhen",
    "VehicleSettings",
    "Wheels",
    "json_schema",
    "load_config",
    "parse_config",
]
