"""imucald determines the mount of an IMU in a vehicle and sends its signals in vehicle axes.

`docs/python.md` explains the use from Python. `__all__` lists the public names. Each public name is
loaded at its first use, because the daemon needs none of them.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from imucald.api.checking import CheckReport, check
    from imucald.api.configuration import Configuration as Config
    from imucald.api.diagnosing import DiagnosisResult, diagnose
    from imucald.api.drive import DriveResult
    from imucald.api.drives import DriveSet
    from imucald.api.files.reading import open_result
    from imucald.api.logs import find_logs
    from imucald.api.mount import CorrectionResult, MountResult
    from imucald.api.replaying import replay
    from imucald.api.streaming import DrivePart, DriveStream, stream
    from imucald.api.walking import WalkResult, walk
    from imucald.core.errors import ConfigError, ImucaldError, LogError
    from imucald.fleet.opened import FleetTables as Fleet

__version__ = "0.2.0"

_PLACES = {
    "CheckReport": ("api.checking", "CheckReport"),
    "Config": ("api.configuration", "Configuration"),
    "ConfigError": ("core.errors", "ConfigError"),
    "DiagnosisResult": ("api.diagnosing", "DiagnosisResult"),
    "DrivePart": ("api.streaming", "DrivePart"),
    "DriveResult": ("api.drive", "DriveResult"),
    "DriveSet": ("api.drives", "DriveSet"),
    "DriveStream": ("api.streaming", "DriveStream"),
    "Fleet": ("fleet.opened", "FleetTables"),
    "ImucaldError": ("core.errors", "ImucaldError"),
    "LogError": ("core.errors", "LogError"),
    "CorrectionResult": ("api.mount", "CorrectionResult"),
    "MountResult": ("api.mount", "MountResult"),
    "WalkResult": ("api.walking", "WalkResult"),
    "check": ("api.checking", "check"),
    "diagnose": ("api.diagnosing", "diagnose"),
    "find_logs": ("api.logs", "find_logs"),
    "open_result": ("api.files.reading", "open_result"),
    "replay": ("api.replaying", "replay"),
    "stream": ("api.streaming", "stream"),
    "walk": ("api.walking", "walk"),
}
"""For each public name: its module, and its name in this module."""

__all__ = [
    "CheckReport",
    "Config",
    "ConfigError",
    "CorrectionResult",
    "DiagnosisResult",
    "DrivePart",
    "DriveResult",
    "DriveSet",
    "DriveStream",
    "Fleet",
    "ImucaldError",
    "LogError",
    "MountResult",
    "WalkResult",
    "__version__",
    "check",
    "diagnose",
    "find_logs",
    "open_result",
    "replay",
    "stream",
    "walk",
]


def __getattr__(name: str) -> Any:
    """Load a public name at its first use (PEP 562)."""
    place = _PLACES.get(name)
    if place is None:
        raise AttributeError(f"module 'imucald' has no attribute {name!r}")
    module, there = place
    found = getattr(import_module(f"imucald.{module}"), there)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
