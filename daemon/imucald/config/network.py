"""Settings of databases, message protection, the bus, output frames, and UDS (ISO 14229)."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, field, structs

from imucald.config.base import CanId, Positive, Settings, SourceAddress


class DatabaseSettings(Settings, frozen=True):
    """A CAN database file, relative to the configuration file."""

    path: str
    channel: str | None = None
    """Name of the bus that the database describes, for a recording of several buses; default: all
    buses."""
    j1939: bool | None = None
    """True: 29-bit ids match by PGN, with any source address; default: as stated in the
    database."""


Databases = Annotated[tuple[DatabaseSettings, ...], Meta(min_length=1)]


class Counter(Settings, frozen=True):
    """Alive counter of a message."""

    signal: str
    modulus: Annotated[int, Meta(ge=2, le=65536)] | None = None
    """Number of values of the counter; default: all values that its bits can represent."""
    max_step: Annotated[int, Meta(ge=1, le=255)] | None = None
    """Largest accepted step; default: the largest step that is possible in the time since the last
    frame."""


class ChecksumSettings(Settings, frozen=True):
    """Checksum of a message."""

    kind: str
    """Kind of the checksum: "none" or a kind of `can.e2e.checksums`."""
    signal: str | None = None
    """Signal that contains the checksum. In E2E profiles, the position is fixed."""
    data_id: int | tuple[int, ...] | None = None
    """E2E data id; for profile 2: a list of sixteen data ids."""
    data_id_mode: Literal["both", "alternating", "low", "nibble"] = "both"
    id_bytes: Annotated[int, Meta(ge=0, le=4)] = 0
    """For XOR and CRCs: number of bytes of the CAN identifier at the start of the checksum's
    input."""
    offset: Annotated[int, Meta(ge=0, le=63)] = 0
    """For E2E: index of the first byte of the header in the frame."""


class MessageProtection(Settings, frozen=True):
    """Cycle time and protection of a message."""

    cycle_time: Positive | None = None
    """Cycle time [s]; default: GenMsgCycleTime of the database, if stated."""
    timeout_cycles: Annotated[float, Meta(ge=1.5, le=1000)] = 10.0
    counter: Counter | None = None
    checksum: ChecksumSettings | None = None
    recover_after: Annotated[int, Meta(ge=0, le=1000)] = 3
    """Number of successive good frames after a fault until the message is used again."""
    source_address: SourceAddress | None = None
    """J1939: only frames of this sender are used, for all sources that state no other sender."""


class BusSettings(Settings, frozen=True):
    """The bus on which `imucald run` receives and sends."""

    interface: str = "socketcan"
    channel: str = "can0"
    bitrate: Annotated[int, Meta(gt=0)] | None = None
    fd: bool = False
    options: dict[str, str | int | float | bool] = field(default_factory=dict)
    """Additional arguments for the bus of python-can."""


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
    """Frames that imucald sends."""

    ids: OutputIds = OutputIds()
    status_rate: Literal[1, 2, 5, 10] = 1
    """Status frames per second."""
    checksum: str = "crc8_j1850"
    """Kind of the checksum: "none" or a kind of one byte of `can.e2e.checksums`."""


KeyFunctionName = Annotated[str, Meta(pattern=r"^[A-Za-z_][\w.]*:[A-Za-z_]\w*$", max_length=200)]


class SecurityAccess(Settings, frozen=True):
    """Access of a tester to routines."""

    key_function: KeyFunctionName | None = None
    """`module:function` that computes the key (bytes) of a seed (bytes). Without it no tester gets
    access."""
    attempts: Annotated[int, Meta(ge=1, le=10)] = 3
    """Number of wrong keys until the delay begins."""
    delay: Positive = 10.0
    """Time after the last of these wrong keys in which access is refused [s]."""


class Uds(Settings, frozen=True):
    """Server of ISO 14229 (UDS) over ISO-TP."""

    enabled: bool = False
    """True: requests are answered. Diagnostics require the extra `diagnostics`."""
    request_id: CanId = 0x7B0
    """Identifier of requests to imucald."""
    response_id: CanId = 0x7B8
    """Identifier of the responses of imucald."""
    functional_id: CanId | None = 0x7DF
    """Identifier of requests to all nodes; with null, such requests are ignored."""
    security: SecurityAccess = SecurityAccess()

    def __post_init__(self) -> None:
        ids = [self.request_id, self.response_id, self.functional_id]
        if len(set(ids)) != len(ids):
            raise ValueError(
                "the request, response and functional ids must differ from one another"
            )
        if (self.request_id > 0x7FF) != (self.response_id > 0x7FF):
            raise ValueError("the request and response ids must both have 11 bits, or both 29 bits")
