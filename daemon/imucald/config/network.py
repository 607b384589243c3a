"""Settings of databases, message protection, the bus, output frames, and UDS (ISO 14229)."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, field, structs

from imucald.config.base import CanId, Positive, Settings, SourceAddress


class DatabaseSettings(Settings, frozen=True):
    """A CAN database file, relative to the configuration file."""

    path: str
    channel: str | None = None
    """Bus of a recording whose frames it describes; every bus when absent."""
    j1939: bool | None = None
    """Match 29-bit ids by PGN, whatever the source address; default: as the database says. An
    11-bit id has no PGN."""


Databases = Annotated[tuple[DatabaseSettings, ...], Meta(min_length=1)]


class Counter(Settings, frozen=True):
    """Alive counter of a message."""

    signal: str
    modulus: Annotated[int, Meta(ge=2, le=65536)] | None = None
    """Number of values before it wraps; default: all that its bits hold."""
    max_step: Annotated[int, Meta(ge=1, le=255)] | None = None
    """Largest step that is still believed; default: what the time that passed has room for."""


class ChecksumSettings(Settings, frozen=True):
    """Checksum of a message."""

    kind: str
    """"none" or a kind that `can.e2e.checksums` knows; judged where the message is known."""
    signal: str | None = None
    """Where it stands; E2E profiles have their own places."""
    data_id: int | tuple[int, ...] | None = None
    """E2E data id; profile 2: a list of sixteen."""
    data_id_mode: Literal["both", "alternating", "low", "nibble"] = "both"
    id_bytes: Annotated[int, Meta(ge=0, le=4)] = 0
    """For kinds that stand in a signal: bytes of the CAN identifier that go in first."""
    offset: Annotated[int, Meta(ge=0, le=63)] = 0
    """E2E: first byte of the header in the frame."""


class MessageProtection(Settings, frozen=True):
    """What is known about a message's cycle and protection."""

    cycle_time: Positive | None = None
    """[s]; default: GenMsgCycleTime of the database, else none is assumed."""
    timeout_cycles: Annotated[float, Meta(ge=1.5, le=1000)] = 10.0
    counter: Counter | None = None
    checksum: ChecksumSettings | None = None
    recover_after: Annotated[int, Meta(ge=0, le=1000)] = 3
    """Good frames in a row after a fault before the message is believed again."""
    source_address: SourceAddress | None = None
    """J1939: the frames of this sender only, for all sources that name none themselves."""


class BusSettings(Settings, frozen=True):
    """The bus that `imucald run` listens and sends on."""

    interface: str = "socketcan"
    channel: str = "can0"
    bitrate: Annotated[int, Meta(gt=0)] | None = None
    fd: bool = False
    options: dict[str, str | int | float | bool] = field(default_factory=dict)
    """Further arguments of python-can's bus."""


class OutputIds(Settings, frozen=True):
    """Identifiers of the frames that imucald sends (see dbc/imucald_out.dbc)."""

    acceleration: CanId = 0x640
    angular_rate: CanId = 0x641
    magnetic_field: CanId = 0x642
    mount: CanId = 0x643
    mount_deviation: CanId = 0x644
    health: CanId = 0x645
    attitude: CanId = 0x646
    attitude_deviation: CanId = 0x647
    rates: CanId = 0x648
    grade: CanId = 0x649
    travel_direction: CanId = 0x64A
    free_acceleration: CanId = 0x64B
    travel_deviation: CanId = 0x64C
    cross_talk_deviation: CanId = 0x64D
    zero_deviation: CanId = 0x64E

    def __post_init__(self) -> None:
        names: dict[int, str] = {}
        for name, can_id in structs.asdict(self).items():
            if can_id in names:
                text = f"{names[can_id]} and {name} have the same id 0x{can_id:X}"
                raise ValueError(f"{text}: give each frame an id of its own")
            names[can_id] = name


class Output(Settings, frozen=True):
    """What is sent."""

    ids: OutputIds = OutputIds()
    status_rate: Literal[1, 2, 5, 10] = 1
    """Status frames per second."""
    checksum: str = "crc8_j1850"
    """"none" or a kind of one byte that `can.e2e.checksums` knows."""


KeyFunctionName = Annotated[str, Meta(pattern=r"^[A-Za-z_][\w.]*:[A-Za-z_]\w*$", max_length=200)]


class SecurityAccess(Settings, frozen=True):
    """Who may start routines."""

    key_function: KeyFunctionName | None = None
    """`module:function` that turns a seed (bytes) into its key (bytes); none: nobody is let in."""
    attempts: Annotated[int, Meta(ge=1, le=10)] = 3
    """Wrong keys before the delay."""
    delay: Positive = 10.0
    """How long no key is taken then [s]."""


class Uds(Settings, frozen=True):
    """An ISO 14229 server over ISO-TP."""

    enabled: bool = False
    """Whether requests are answered; needs the extra `diagnostics`."""
    request_id: CanId = 0x7B0
    """Requests to us."""
    response_id: CanId = 0x7B8
    """Our responses."""
    functional_id: CanId | None = 0x7DF
    """Requests to all nodes; null: these are not listened to."""
    security: SecurityAccess = SecurityAccess()

    def __post_init__(self) -> None:
        ids = [self.request_id, self.response_id, self.functional_id]
        if len(set(ids)) != len(ids):
            raise ValueError(
                "the request, response and functional ids must differ from one another"
            )
        if (self.request_id > 0x7FF) != (self.response_id > 0x7FF):
            raise ValueError("the request and response ids must both have 11 bits, or both 29 bits")
