"""Settings that assign signals to quantities, and short forms of the configuration.

A source may be written as text (``MESSAGE.SIGNAL``). A database or a model file may be written as
its path. A single entry may replace a list. Other forms are not changed here; the check of the
settings refuses them.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from typing import Annotated, Any, Literal

from msgspec import Meta

from imucald.config.base import STANDARD_ID_MAX, CanId, Settings, SourceAddress
from imucald.core.samples import QUANTITIES

MESSAGE_SIGNAL = r"^[^.\s]+\.[^.\s]+$"
"""Pattern of ``MESSAGE.SIGNAL`` in the JSON schema, for editors."""


def _all_of(values: tuple[float, ...] | float) -> tuple[float, ...]:
    return (values,) if isinstance(values, int | float) else values


class RawSource(Settings, frozen=True, kw_only=True):
    """A value computed from a frame's bytes, for frames that no database describes (OBD-II)."""

    id: CanId
    extended: bool = False
    """True: the identifier has 29 bits. Identifiers above 0x7FF always have 29 bits."""
    when: str | None = None
    """Condition with data[i] and length. Frames that do not meet the condition are ignored."""
    value: str
    """Expression with data[i] for the value."""

    @property
    def is_extended(self) -> bool:
        """True if the identifier has 29 bits."""
        return self.extended or self.id > STANDARD_ID_MAX


class ValidWhen(Settings, frozen=True):
    """A status signal of the same message that shows whether the sensor's values are valid."""

    signal: str
    """Name of the status signal, without the message."""
    equals: tuple[float, ...] | float
    """Physical value, or values, of the status signal at which the sensor is valid."""

    @property
    def values(self) -> tuple[float, ...]:
        """All values of the status signal at which the sensor is valid."""
        return _all_of(self.equals)


class SourceSettings(Settings, frozen=True):
    """Source of one number: ``MESSAGE.SIGNAL`` alone, or a mapping with further keys."""

    signal: Annotated[str, Meta(extra_json_schema={"pattern": MESSAGE_SIGNAL})] | None = None
    """Signal in a database, as ``MESSAGE.SIGNAL``."""
    raw: RawSource | None = None
    """An expression for the bytes of a frame, instead of `signal`."""
    sign_signal: Annotated[str, Meta(extra_json_schema={"pattern": MESSAGE_SIGNAL})] | None = None
    """Sign bit of a magnitude, as ``MESSAGE.SIGNAL``. 1 means negative."""
    source_address: SourceAddress | None = None
    """J1939: only frames of this sender are used; default: the sender stated for the sensor or the
    message."""
    unit: str | None = None
    """Unit that replaces the unit in the database."""
    sign: Literal[-1, 1] = 1
    offset: float = 0.0
    """Number that is added to the physical value, in its unit, before the sign is applied."""
    channel: str | None = None
    """Name of the bus with the signal, for a recording of several buses. No effect on a live
    bus."""
    range: tuple[float, float] | None = None
    """Smallest and largest plausible physical value, in the unit of the source, before offset and
    sign are applied."""
    not_available: tuple[int, ...] = ()
    """Raw values that mean 'not available'."""
    value_table: bool = True
    """True: raw values with the name SNA, not available, invalid, error or init in the database's
    value table also mean 'not available'."""
    valid_when: ValidWhen | None = None
    """Status signal of the sensor. Values that the status signal marks as invalid are rejected."""
    equals: tuple[float, ...] | float | None = None
    """For on/off quantities: on if the physical value equals this value, or one of these values."""
    above: float | None = None
    """For on/off quantities: on if the physical value is larger than this value."""

    def __post_init__(self) -> None:
        if (self.signal is None) == (self.raw is None):
            raise ValueError("give either 'signal: MESSAGE.SIGNAL' or 'raw: {id, value}'")
        if self.raw is not None and self.valid_when is not None:
            raise ValueError("'valid_when' needs 'signal'; in a raw source write 'when'")
        if self.raw is not None and self.sign_signal is not None:
            raise ValueError(
                "'sign_signal' needs 'signal'; in a raw source, write the sign into "
                "the expression of 'value'"
            )
        if self.raw is not None and self.source_address is not None:
            raise ValueError(
                "'source_address' needs 'signal'; in a raw source, the 'id' contains the address"
            )
        if self.range is not None and self.range[0] >= self.range[1]:
            raise ValueError("range must be [low, high] with low < high")

    @property
    def on_values(self) -> tuple[float, ...] | None:
        """All physical values at which an on/off quantity is on; None without `equals`."""
        return None if self.equals is None else _all_of(self.equals)


Sources = Annotated[tuple[SourceSettings, ...], Meta(min_length=1)]
"""One source, or several in order of preference."""


class TriadSettings(Settings, frozen=True):
    """The three axes of one sensor, as the sensor defines them. An accelerometer may have no z
    axis."""

    x: SourceSettings
    y: SourceSettings
    z: SourceSettings | None = None
    source_address: SourceAddress | None = None
    """J1939: the frames of all axes are from this sender."""

    def __post_init__(self) -> None:
        axes = {"x": self.x, "y": self.y, "z": self.z}
        names = [axis for axis, source in axes.items() if source and source.signal]
        for first, second in combinations(names, 2):
            one, other = axes[first], axes[second]
            if one and other and one.signal == other.signal:
                raise ValueError(f"{first} and {second} name the same signal, {one.signal}")


Triads = Annotated[tuple[TriadSettings, ...], Meta(min_length=1)]


class Wheels(Settings, frozen=True):
    """Wheel speeds."""

    front_left: SourceSettings
    front_right: SourceSettings
    rear_left: SourceSettings
    rear_right: SourceSettings


class ParallelSensor(Settings, frozen=True):
    """Another sensor whose axes are parallel to the accelerometer's axes. Its samples are corrected
    with the same matrix.

    A sensor without a z axis must be level, and requires an accelerometer that is configured as
    level.
    """

    name: Annotated[str, Meta(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,31}$(?!\n)")]
    kind: Literal["acceleration", "angular_rate", "magnetic_field"]
    x: SourceSettings
    y: SourceSettings
    id: CanId
    """Identifier of the frame with the corrected values."""
    z: SourceSettings | None = None
    source_address: SourceAddress | None = None
    """J1939: the frames of all axes are from this sender."""


class Signals(Settings, frozen=True):
    """The signals of the bus, by quantity."""

    accelerometer: Triads
    gyroscope: Triads | None = None
    magnetometer: Triads | None = None
    speed: Sources | None = None
    wheel_speeds: Wheels | None = None
    steering_wheel_angle: Sources | None = None
    yaw_rate: Sources | None = None
    lateral_acceleration: Sources | None = None
    longitudinal_acceleration: Sources | None = None
    reverse: Sources | None = None
    brake: Sources | None = None
    temperature: Sources | None = None
    heading: Sources | None = None
    parallel: Annotated[tuple[ParallelSensor, ...], Meta(max_length=8)] = ()

    def __post_init__(self) -> None:
        for triads in (self.gyroscope, self.magnetometer):
            if triads and any(triad.z is None for triad in triads):
                raise ValueError("only the accelerometer may lack its z axis")
        names = [sensor.name for sensor in self.parallel]
        if len(set(names)) != len(names):
            raise ValueError("two parallel sensors have the same name")


SHORT_TEXTS: dict[str, dict[str, Any]] = {
    "SourceSettings": {"type": "string", "pattern": MESSAGE_SIGNAL},
    "DatabaseSettings": {"type": "string"},
    "ModelFile": {"type": "string"},
}
"""JSON schema of the text that may replace settings, by their class."""
ONE_OF_LIST = frozenset({"SourceSettings", "DatabaseSettings", "TriadSettings"})
"""Classes of settings for which a single entry may be written instead of a list."""
_TRIADS = frozenset(row.key for row in QUANTITIES.values() if row.width == 3)
_AXES = frozenset({"x", "y", "z"})


def spelled_out(data: dict[Any, Any]) -> dict[Any, Any]:
    """Return the data with all short forms replaced by full forms. The argument is not changed."""
    found = dict(data)
    if "database" in found:
        found["database"] = _each(found["database"], lambda one: _long(one, "path"))
    if "model" in found:
        found["model"] = _long(found["model"], "path")
    signals = found.get("signals")
    if isinstance(signals, dict):
        found["signals"] = {key: _signal(key, value) for key, value in signals.items()}
    return found


def _signal(key: Any, value: Any) -> Any:
    if key in _TRIADS:
        return _each(value, _axes)
    if key == "wheel_speeds":
        return {k: _source(v) for k, v in value.items()} if isinstance(value, dict) else value
    if key == "parallel":
        return [_axes(sensor) for sensor in value] if isinstance(value, list) else value
    return _each(value, _source)


def _each(value: Any, spell: Callable[[Any], Any]) -> Any:
    if value is None:
        return None
    return [spell(one) for one in (value if isinstance(value, list) else [value])]


def _axes(value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    return {key: _source(one) if key in _AXES else one for key, one in value.items()}


def _source(value: Any) -> Any:
    return _long(value, "signal")


def _long(value: Any, key: str) -> Any:
    return {key: value} if isinstance(value, str) else value
