"""Units of signals, as databases and people write them, and their way to SI."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

from imucald.core.angles import RAD_PER_DEG
from imucald.core.errors import ConfigError
from imucald.core.samples import GRAVITY


class Unit(Struct, frozen=True):
    """A unit of one dimension: ``si = factor * value + offset``."""

    dimension: str
    factor: float
    offset: float = 0.0


_TABLE: tuple[tuple[Unit, tuple[str, ...]], ...] = (
    (Unit("acceleration", 1.0), ("m/s^2", "m/s²", "m/s2", "m/s/s", "m/ss", "m/s**2", "mps2")),
    (Unit("acceleration", 1.0), ("mps^2", "meter/s^2", "m/sec^2", "ms-2")),
    (Unit("acceleration", GRAVITY), ("g", "g0", "gn", "G", "G-force")),
    (Unit("acceleration", GRAVITY * 1e-3), ("mg", "milli-g")),
    (Unit("acceleration", 1e-3), ("mm/s^2", "mm/s²")),
    (Unit("acceleration", 0.3048), ("ft/s^2", "ft/s²")),
    (Unit("angular_rate", 1.0), ("rad/s", "rad/sec", "1/s")),
    (Unit("angular_rate", RAD_PER_DEG), ("deg/s", "°/s", "degree/s", "degrees/s", "deg/sec")),
    (Unit("angular_rate", RAD_PER_DEG), ("º/s", "dps", "grad/s")),
    (Unit("angular_rate", RAD_PER_DEG * 1e-3), ("mdeg/s", "mdps")),
    (Unit("angular_rate", RAD_PER_DEG / 3600.0), ("deg/h", "°/h")),
    (Unit("angle", 1.0), ("rad",)),
    (Unit("angle", RAD_PER_DEG), ("deg", "°", "degree", "degrees", "º", "grad")),
    (Unit("speed", 1.0), ("m/s", "mps", "m/sec", "meter/s")),
    (Unit("speed", 1.0 / 3.6), ("km/h", "kph", "kmh", "kmph", "km/hr", "KPH")),
    (Unit("speed", 0.44704), ("mph", "mi/h", "miles/h")),
    (Unit("speed", 1852.0 / 3600.0), ("kn", "kt", "kts", "knot", "knots")),
    (Unit("speed", 0.3048), ("ft/s",)),
    (Unit("magnetic_field", 1.0), ("T",)),
    (Unit("magnetic_field", 1e-6), ("uT", "µT", "μT", "microtesla")),
    (Unit("magnetic_field", 1e-7), ("mG", "mGauss", "milligauss")),
    (Unit("magnetic_field", 1e-4), ("Gs", "Gauss", "gauss")),
    (Unit("magnetic_field", 1e-9), ("nT",)),
    (Unit("temperature", 1.0), ("degC", "°C", "C", "Celsius", "deg C", "ºC")),
    (Unit("temperature", 1.0, -273.15), ("K", "kelvin", "Kelvin")),
    (Unit("temperature", 5.0 / 9.0, -160.0 / 9.0), ("degF", "°F", "F")),
    (Unit("flag", 1.0), ("", "bool", "-", "%", "bit", "bar", "kPa")),
)  # fmt: skip

_EXACT: Mapping[tuple[str, str], Unit] = {
    (unit.dimension, name): unit for unit, names in _TABLE for name in names
}
_FOLDED: Mapping[tuple[str, str], Unit] = {
    (unit.dimension, name.casefold()): unit for unit, names in _TABLE for name in names
}

DIMENSIONS = tuple(dict.fromkeys(unit.dimension for unit, _ in _TABLE))


def unit_names(dimension: str) -> tuple[str, ...]:
    """One accepted spelling per unit of a dimension, for messages."""
    return tuple(names[0] for unit, names in _TABLE if unit.dimension == dimension)


def find_unit(text: str, dimension: str) -> Unit:
    """Return the unit that `text` names in a dimension.

    Raises ConfigError, listing what is known, where the text is not a unit of that dimension.
    """
    name = text.strip()
    unit = _EXACT.get((dimension, name)) or _FOLDED.get((dimension, name.casefold()))
    if unit is None and dimension == "flag":
        return Unit("flag", 1.0)
    if unit is None:
        known = ", ".join(unit_names(dimension))
        kind = dimension.replace("_", " ")
        raise ConfigError(f"{text!r} is not a unit of {kind} (known: {known})")
    return unit
