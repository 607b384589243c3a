"""YAML -> typed settings. Every mistake is one clear line with its place in the file and a remedy.

The models below are the configuration reference's source: `imucald schema` prints their JSON schema
and ``docs/configuration.md`` is checked against them. Files are untrusted: size, nesting and
aliases are bounded before anything is built from them.
"""

from __future__ import annotations

import difflib
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from imucald.errors import ConfigError
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.published_settings import PublishedSettings

MAX_FILE_BYTES = 1_000_000
"""Largest accepted file: a thousand times a real one."""
MAX_DEPTH = 30
"""Deepest accepted nesting."""

STANDARD_ID_MAX = 0x7FF
EXTENDED_ID_MAX = 0x1FFF_FFFF


class _Model(BaseModel):
    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True
    )


CanId = Annotated[int, Field(ge=0, le=EXTENDED_ID_MAX)]
Positive = Annotated[float, Field(gt=0)]
Share = Annotated[float, Field(gt=0, le=1)]


class RawSource(_Model):
    """A value computed from a frame's bytes, for frames that no database describes (OBD-II)."""

    id: CanId
    extended: bool = False
    """29-bit identifier; set by itself when the id needs one."""
    when: str | None = None
    """Condition on data[i] and length; frames that fail it are not this signal."""
    value: str
    """Expression on data[i]."""

    @property
    def is_extended(self) -> bool:
        """Whether the identifier has 29 bits."""
        return self.extended or self.id > STANDARD_ID_MAX


def _signal_shorthand(value: Any) -> Any:
    return {"signal": value} if isinstance(value, str) else value


class Source(_Model):
    """Where one number comes from: ``MESSAGE.SIGNAL`` alone, or a mapping with more."""

    signal: str | None = Field(None, pattern=r"^[^.\s]+\.[^.\s]+$")
    """``MESSAGE.SIGNAL`` in the database."""
    raw: RawSource | None = None
    """Instead of `signal`: bytes and an expression."""
    unit: str | None = None
    """Overrides the unit in the database."""
    sign: Literal[-1, 1] = 1
    offset: float = 0.0
    """Added to the physical value, in its unit, before the sign."""
    channel: str | None = None
    """Bus of a recording with several; without effect on a live bus."""
    range: tuple[float, float] | None = None
    """Plausible physical values, in the source's unit, before offset and sign."""
    not_available: tuple[int, ...] = ()
    """Raw values that mean 'not available'."""
    equals: tuple[float, ...] | float | None = None
    """For on/off quantities: on when the physical value is (one of) this."""
    above: float | None = None
    """For on/off quantities: on when the physical value is larger."""

    @model_validator(mode="after")
    def _one_origin(self) -> Source:
        if (self.signal is None) == (self.raw is None):
            raise ValueError("give either 'signal: MESSAGE.SIGNAL' or 'raw: {id, value}'")
        if self.range is not None and self.range[0] >= self.range[1]:
            raise ValueError("range must be [low, high] with low < high")
        return self


OneSource = Annotated[Source, BeforeValidator(_signal_shorthand)]


def _as_list(value: Any) -> Any:
    return value if isinstance(value, list | tuple) or value is None else [value]


Sources = Annotated[tuple[OneSource, ...], BeforeValidator(_as_list), Field(min_length=1)]
"""One source, or several in order of preference."""


class Triad(_Model):
    """Three axes of one sensor, in its own axes; an accelerometer may lack z (planar)."""

    x: OneSource
    y: OneSource
    z: OneSource | None = None


Triads = Annotated[tuple[Triad, ...], BeforeValidator(_as_list), Field(min_length=1)]


class Wheels(_Model):
    """Wheel speeds."""

    front_left: OneSource
    front_right: OneSource
    rear_left: OneSource
    rear_right: OneSource


class ParallelSensor(_Model):
    """Another sensor whose axes are parallel to the accelerometer's; gets the same correction."""

    name: str = Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,31}$")
    kind: Literal["acceleration", "angular_rate", "magnetic_field"]
    x: OneSource
    y: OneSource
    z: OneSource
    id: CanId
    """Identifier of the frame with its corrected values."""


class Signals(_Model):
    """Which signal is which quantity."""

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
    parallel: tuple[ParallelSensor, ...] = Field((), max_length=8)

    @model_validator(mode="after")
    def _planar_only_alone(self) -> Signals:
        for triads in (self.gyroscope, self.magnetometer):
            if triads and any(triad.z is None for triad in triads):
                raise ValueError("only the accelerometer may lack its z axis")
        return self


class Database(_Model):
    """A CAN database file, relative to the configuration file."""

    path: str
    channel: str | None = None
    """Bus of a recording whose frames it describes; every bus when absent."""
    j1939: bool | None = None
    """Match 29-bit ids by PGN, whatever the source address; default: as the database says."""


def _path_shorthand(value: Any) -> Any:
    return {"path": value} if isinstance(value, str) else value


Databases = Annotated[
    tuple[Annotated[Database, BeforeValidator(_path_shorthand)], ...],
    BeforeValidator(_as_list),
    Field(min_length=1),
]


class Counter(_Model):
    """Alive counter of a message."""

    signal: str
    modulus: int | None = Field(None, ge=2, le=65536)
    """Number of values before it wraps; default: all that its bits hold."""
    max_step: int = Field(1, ge=1, le=255)
    """Largest step that is still believed (frames lost in between)."""


class Checksum(_Model):
    """Checksum of a message."""

    kind: Literal["none", "xor", "crc8_j1850", "e2e_p1", "e2e_p2", "e2e_p5", "e2e_p11"]
    signal: str | None = None
    """Where it stands; E2E profiles have their own places."""
    data_id: int | tuple[int, ...] | None = None
    """E2E data id; profile 2: a list of sixteen."""
    data_id_mode: Literal["both", "alternating", "low", "nibble"] = "both"
    id_bytes: int = Field(0, ge=0, le=4)
    """For xor and crc8_j1850: bytes of the CAN identifier that go in first."""
    offset: int = Field(0, ge=0, le=63)
    """E2E: first byte of the header in the frame."""


class MessageProtection(_Model):
    """What is known about a message's cycle and protection."""

    cycle_time: Positive | None = None
    """[s]; default: GenMsgCycleTime of the database, else none is assumed."""
    timeout_cycles: Annotated[float, Field(ge=1.5, le=1000)] = 10.0
    counter: Counter | None = None
    checksum: Checksum | None = None
    recover_after: int = Field(3, ge=0, le=1000)
    """Good frames in a row after a fault before the message is believed again."""


class Bus(_Model):
    """The bus that `imucald run` listens and sends on."""

    interface: str = "socketcan"
    channel: str = "can0"
    bitrate: int | None = Field(None, gt=0)
    fd: bool = False
    options: dict[str, str | int | float | bool] = Field(default_factory=dict)
    """Further arguments of python-can's bus."""


class OutputIds(_Model):
    """Identifiers of the frames that imucald sends (see dbc/imucald_out.dbc)."""

    acceleration: CanId = 0x640
    angular_rate: CanId = 0x641
    magnetic_field: CanId = 0x642
    mount: CanId = 0x643
    mount_deviation: CanId = 0x644
    health: CanId = 0x645

    @model_validator(mode="after")
    def _distinct(self) -> OutputIds:
        ids = list(self.model_dump().values())
        if len(set(ids)) != len(ids):
            raise ValueError("two output frames have the same id")
        return self


class Output(_Model):
    """What is sent."""

    ids: OutputIds = OutputIds()
    status_rate: Literal[1, 2, 5, 10] = 1
    """Status frames per second."""
    checksum: Literal["crc8_j1850", "xor", "none"] = "crc8_j1850"


class Vehicle(_Model):
    """What is known about the vehicle."""

    id: str = Field("vehicle", max_length=64)
    """Identity; a saved state is used for the same vehicle only."""
    driving_side: Literal["left", "right", "unknown"] = "unknown"
    """Side of the road it drives on: the road's crown leans the vehicle towards the kerb."""
    crown_percent: float = Field(1.2, ge=0, le=5)
    """Mean cross slope of the roads it uses, towards the kerb."""
    crown_spread_percent: float = Field(0.6, gt=0, le=5)
    """Spread of that mean from drive to drive."""
    wheelbase: Positive = 2.7
    """[m]; turns the steering angle into a yaw rate where there is no other."""
    steering_ratio: Positive = 15.0
    """Steering-wheel angle over road-wheel angle."""
    track: Positive = 1.55
    """[m]; how much the wheels may differ in a curve."""


_METHOD_A = PublishedSettings()
_FULL = EstimatorSettings()


def _deg(radians: float) -> float:
    return round(math.degrees(radians), 6)


class StaticTest(_Model):
    """Method A, steps 1 to 3: when the vehicle stands, and its tilt from gravity."""

    samples: int = Field(_METHOD_A.static.count, ge=2, le=100_000)
    """Accelerometer samples that a window needs."""
    duration: Positive = _METHOD_A.static.seconds
    """Time that it must span [s]."""
    threshold: tuple[Positive, Positive, Positive] = _METHOD_A.static.thresholds
    """Largest max - min per axis [m/s^2], where speed is not known."""
    threshold_at_zero_speed: tuple[Positive, Positive, Positive] = (
        _METHOD_A.static.thresholds_at_zero_speed
    )
    """The same where speed is known to be zero: a running engine shakes the sensor."""
    standstill_speed: Positive = _METHOD_A.standstill_speed
    """Speed up to which the vehicle stands [m/s]."""
    average_stops: bool = _METHOD_A.average_stops
    """All stops count (beyond the publication); else the last one decides."""


class StraightMotion(_Model):
    """Method A, step 4: which motion counts as straight and of variable speed."""

    recognise_by: tuple[Literal["yaw_rate", "steering", "consistency"], ...] = Field(
        ("yaw_rate", "steering", "consistency"), min_length=1
    )
    """In order of preference; the first whose signal is there decides."""
    yaw_rate_limit_deg_s: Positive = _deg(_METHOD_A.yaw_rate_limit)
    yaw_rate_limit_without_speed_deg_s: Positive = _deg(_METHOD_A.yaw_rate_limit_without_speed)
    steering_limit_deg: Positive = _deg(_METHOD_A.steering_limit)
    lateral_limit: float = Field(_METHOD_A.lateral_limit, ge=0)
    """Largest |v r| [m/s^2]; 0 switches this gate off."""
    min_speed_change: Positive = _METHOD_A.min_speed_change
    """Smallest |dv/dt| [m/s^2]."""
    manoeuvre_peak: Positive = _METHOD_A.manoeuvre_peak
    """|dv/dt| that a manoeuvre must reach to count [m/s^2]."""
    min_speed: Positive = _METHOD_A.min_speed
    """[m/s]"""
    consistency_window: int = Field(_METHOD_A.consistency_window, ge=2, le=1000)
    """Successive angles, ten a second, that must agree."""
    consistency_range_deg: Positive = _deg(_METHOD_A.consistency_spread)


class TargetAngle(_Model):
    """Method A, step 5: the yaw angle and its sign."""

    sign_from: tuple[Literal["speed", "brake", "turn", "first_motion"], ...] = Field(
        ("speed", "brake", "turn", "first_motion"), min_length=1
    )
    """What may tell accelerating from braking, in order of preference."""
    subtract_lateral: bool = _METHOD_A.subtract_lateral
    """Subtract v r where speed and yaw rate are known (beyond the publication)."""
    remove_offset_after: float = Field(_METHOD_A.remove_offset_after, ge=0)
    """Time constant of the mean that is removed, since slope and bias wander [s]; 0: never."""


class States(_Model):
    """From which standard deviations on the estimate is used; left again at 1.4 times."""

    usable_yaw_deg: Positive = _deg(_FULL.usable_std)
    usable_tilt_deg: Positive = _deg(_FULL.usable_tilt_std)
    fine_yaw_deg: Positive = _deg(_FULL.fine_std)
    fine_tilt_deg: Positive = _deg(_FULL.fine_tilt_std)


class Calibration(_Model):
    """How the mount is found."""

    estimator: Literal["full", "published"] = "full"
    """"published" is method A alone; "full" fuses all the evidence there is."""
    accelerometer_bias: Positive = round(_FULL.accel_bias_std, 6)
    """Standard deviation of the accelerometer's zero error [m/s^2]."""
    accelerometer_range: Positive | None = None
    """Full scale [m/s^2]; nothing is learnt close to it."""
    cross_axis: float = Field(0.0, ge=0, le=0.05)
    """Cross-axis error of the accelerometer (part): widens the intervals."""
    speed_delay: float | None = Field(None, ge=-0.5, le=1.2)
    """How late speed is against the accelerometer [s]; estimated when absent."""
    states: States = States()
    static: StaticTest = StaticTest()
    straight: StraightMotion = StraightMotion()
    target_angle: TargetAngle = TargetAngle()


class Config(_Model):
    """A whole configuration file."""

    vehicle: Vehicle = Vehicle()
    database: Databases
    signals: Signals
    messages: dict[str, MessageProtection] = Field(default_factory=dict)
    bus: Bus = Bus()
    calibration: Calibration = Calibration()
    output: Output = Output()


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
        base = self.path.parent if self.path is not None else Path.cwd()
        return (base / database.path).resolve()

    def with_databases(self, entries: tuple[Database, ...]) -> LoadedConfig:
        """The same configuration with other database entries."""
        config = self.config.model_copy(update={"database": entries})
        return LoadedConfig(config, self.path, self._marks)

    def error(self, place: tuple[str | int, ...], text: str) -> ConfigError:
        """An error at a key of the file, such as ("signals", "speed", 0)."""
        return ConfigError(f"{self._where(place)}{_dotted(place)}: {text}")

    def _where(self, place: tuple[str | int, ...]) -> str:
        name = str(self.path) if self.path is not None else "<config>"
        return f"{name}:{_line_of(self._marks, place)}: "


Marks = dict[tuple[str | int, ...], int]
"""Line (from 1) of every key and item."""


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
    try:
        config = Config.model_validate(data)
    except ValidationError as error:
        raise ConfigError("\n".join(_explain(error, marks, name, data))) from None
    return LoadedConfig(config, path, marks)


def json_schema() -> str:
    """JSON schema (draft 2020-12) of the configuration."""
    return json.dumps(Config.model_json_schema(), indent=2)


# YAML, with lines ------------------------------------------------------------------------------


def read_yaml(text: str, name: str) -> tuple[Any, Marks]:
    """Parse YAML to plain data and the line of every key.

    Aliases, repeated keys and deep nesting are refused: no configuration needs them, and they are
    how a file becomes a bomb. Raises ConfigError with the line.
    """
    try:
        loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)(text)
        try:
            for event in yaml.parse(text, Loader=type(loader)):
                if isinstance(event, yaml.AliasEvent):
                    line = event.start_mark.line + 1 if event.start_mark else 1
                    raise ConfigError(f"{name}:{line}: YAML aliases (*name) are not accepted")
            node = loader.get_single_node()
            marks: Marks = {}
            data = None if node is None else _build(loader, node, (), marks, name)
        finally:
            loader.dispose()
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = mark.line + 1 if mark is not None else 1
        problem = getattr(error, "problem", None) or str(error).splitlines()[0]
        raise ConfigError(f"{name}:{line}: not valid YAML: {problem}") from None
    except (RecursionError, ValueError, OverflowError) as error:
        raise ConfigError(f"{name}:1: not usable YAML: {error}") from None
    return data, marks


def _build(
    loader: Any, node: yaml.Node, place: tuple[str | int, ...], marks: Marks, name: str
) -> Any:
    line = node.start_mark.line + 1
    marks.setdefault(place, line)
    if len(place) > MAX_DEPTH:
        raise ConfigError(f"{name}:{line}: nested too deeply")
    if isinstance(node, yaml.SequenceNode):
        return [_build(loader, n, (*place, i), marks, name) for i, n in enumerate(node.value)]
    if isinstance(node, yaml.MappingNode):
        result: dict[str, Any] = {}
        for key_node, value_node in node.value:
            key_line = key_node.start_mark.line + 1
            if not isinstance(key_node, yaml.ScalarNode):
                raise ConfigError(f"{name}:{key_line}: a key must be a plain word")
            key = key_node.value
            if key in result:
                raise ConfigError(f"{name}:{key_line}: the key '{key}' stands here a second time")
            marks[(*place, key)] = key_line
            result[key] = _build(loader, value_node, (*place, key), marks, name)
        return result
    value = loader.construct_object(node)
    if value is not None and not isinstance(value, str | int | float | bool):
        raise ConfigError(f"{name}:{line}: {node.value!r} is neither text nor number")
    return value


# Errors made readable --------------------------------------------------------------------------


def _explain(error: ValidationError, marks: Marks, name: str, data: Any) -> Iterator[str]:
    for item in error.errors(include_url=False):
        place = _real_place(item["loc"], data)
        yield f"{name}:{_line_of(marks, place)}: {_dotted(place)}: {_reason(item, place)}"


def _real_place(loc: tuple[str | int, ...], data: Any) -> tuple[str | int, ...]:
    """Drop what shorthands added to the path (the index of a single source, union branches)."""
    place: list[str | int] = []
    here = data
    last = len(loc) - 1
    for i, part in enumerate(loc):
        if isinstance(here, dict) and isinstance(part, str) and (part in here or i == last):
            place.append(part)
            here = here.get(part)
        elif isinstance(here, list) and isinstance(part, int) and part < len(here):
            place.append(part)
            here = here[part]
    return tuple(place)


def _reason(item: Any, place: tuple[str | int, ...]) -> str:
    kind = item["type"]
    if kind == "extra_forbidden":
        allowed = _allowed_keys(place[:-1])
        close = difflib.get_close_matches(str(place[-1]), allowed, n=1)
        hint = f"did you mean '{close[0]}'?" if close else "allowed: " + ", ".join(allowed)
        return f"unknown key; {hint}"
    if kind == "missing":
        return "is missing"
    message = str(item["msg"]).removeprefix("Value error, ")
    value = item.get("input")
    if isinstance(value, str | int | float | bool) or value is None:
        return f"{message[:1].lower()}{message[1:]} (here: {value!r})"
    return f"{message[:1].lower()}{message[1:]}"


def _allowed_keys(place: tuple[str | int, ...]) -> list[str]:
    """Keys allowed at a place, by walking the models' JSON schema."""
    schema = Config.model_json_schema()
    definitions = schema.get("$defs", {})
    here: list[dict[str, Any]] = [schema]
    for part in place:
        here = [branch for node in here for branch in _children(node, part, definitions)]
    return sorted({key for node in here for key in node.get("properties", {})})


def _children(
    node: dict[str, Any], part: str | int, definitions: dict[str, Any]
) -> Iterator[dict[str, Any]]:
    if isinstance(part, int):
        step = node.get("items", {})
    else:
        step = node.get("properties", {}).get(part) or node.get("additionalProperties") or {}
    pending = [step] if isinstance(step, dict) else []
    while pending:
        branch = pending.pop()
        if "$ref" in branch:
            branch = definitions.get(str(branch["$ref"]).rsplit("/", 1)[-1], {})
        pending.extend(branch.get("anyOf", []))
        # a single source may stand where a list of them is described
        if "items" in branch and isinstance(branch["items"], dict):
            pending.append(branch["items"])
        yield branch


def _line_of(marks: Marks, place: tuple[str | int, ...]) -> int:
    while place and place not in marks:
        place = place[:-1]
    return marks.get(place, 1)


def _dotted(place: tuple[str | int, ...]) -> str:
    text = ""
    for part in place:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text or "configuration"
