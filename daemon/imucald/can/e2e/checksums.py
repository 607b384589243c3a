"""All kinds of checksums of messages: XOR, CRC-8, CRC-16, AUTOSAR E2E profiles.

To add a kind (another CRC-8 or CRC-16), add a function that returns its `ChecksumSpec`, and a line
in `KINDS`. Configurations use the names in `KINDS`. A reflected CRC takes more, see
`checksum_engine._table`.

Source: AUTOSAR PRS "E2E Protocol Specification" (profiles 1, 2, 5, 11) and SWS "CRC Library".
Profiles 1 and 11 start their CRC-8 SAE J1850 at 0 and do not invert it. The PRS calls the routine
with the XOR value as start value and inverts the result again. In this way the profile stays
compatible with its first release.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Literal, Protocol

from msgspec import Struct
from msgspec.structs import replace

from imucald.can.columns import CAN_EFF_MASK
from imucald.can.dbc.bits import Field, field_of
from imucald.can.dbc.message import Message
from imucald.can.e2e.checksum_engine import ChecksumSpec
from imucald.can.e2e.protection_spec import CounterSpec
from imucald.core.errors import ConfigError

J1850_POLYNOMIAL = 0x1D
"""Polynomial of CRC-8 SAE J1850."""

H2F_POLYNOMIAL = 0x2F
"""Polynomial of the CRC-8 of E2E profile 2 (AUTOSAR Crc_CalculateCRC8H2F)."""

CCITT_POLYNOMIAL = 0x1021
"""Polynomial of CRC-16-CCITT, also used by E2E profile 5 (AUTOSAR Crc_CalculateCRC16, start
0xFFFF)."""

E2E_COUNTER_VALUES = 16
"""Number of values of a counter with four bits (E2E profiles 1, 2 and 11)."""

DataIdMode = Literal["both", "alternating", "low", "nibble"]


class ChecksumOptions(Protocol):
    """The settings of a message's checksum. Each kind reads only the settings that it needs."""

    @property
    def signal(self) -> str | None:
        """The signal that contains the checksum."""

    @property
    def id_bytes(self) -> int:
        """Number of bytes of the CAN identifier at the start of the checksum's input."""

    @property
    def offset(self) -> int:
        """Index of the first byte of an E2E header."""

    @property
    def data_id(self) -> int | tuple[int, ...] | None:
        """The E2E data id; profile 2 has sixteen data ids."""

    @property
    def data_id_mode(self) -> DataIdMode:
        """The bytes of the data id that are inputs of the checksum."""


class HeaderCounter(Struct, frozen=True):
    """The alive counter in an E2E header: bit offset in the header, number of bits, number of
    values."""

    bit: int
    length: int
    modulus: int

    def at(self, header_bit: int, max_jump: int | None = None) -> CounterSpec:
        """Return the counter of a header that starts at bit `header_bit`."""
        field = Field(header_bit + self.bit, self.length, "little_endian")
        return CounterSpec(field, self.modulus, max_jump)


SignalChecksum = Callable[[int, int, bytes], ChecksumSpec]
"""Function with the arguments: size of the message [bytes], index of the checksum's first byte,
identifier bytes at the start of the input."""


class ChecksumKind(Struct, frozen=True):
    """One kind of checksum.

    make: returns the checksum of a message; may raise ConfigError. counter: the alive counter that
    an E2E profile defines. in_signal: function of a kind that has its own signal and covers
    identifier bytes and payload.
    """

    make: Callable[[Message, ChecksumOptions], ChecksumSpec]
    counter: HeaderCounter | None = None
    in_signal: SignalChecksum | None = None


def xor_checksum(size: int, position: int, id_bytes: bytes = b"") -> ChecksumSpec:
    """XOR of all other bytes and the identifier bytes."""
    return ChecksumSpec(size, position, prefixes=(id_bytes,))


def crc8_j1850(size: int, position: int, id_bytes: bytes = b"") -> ChecksumSpec:
    """CRC-8 SAE J1850 (0x1D, start 0xFF, inverted) over identifier bytes and all other bytes."""
    return ChecksumSpec(size, position, 1, J1850_POLYNOMIAL, 0xFF, 0xFF, prefixes=(id_bytes,))


def crc16_ccitt(size: int, position: int, id_bytes: bytes = b"") -> ChecksumSpec:
    """CRC-16-CCITT (0x1021, start 0xFFFF, not inverted: AUTOSAR Crc_CalculateCRC16)."""
    return ChecksumSpec(size, position, 2, CCITT_POLYNOMIAL, 0xFFFF, prefixes=(id_bytes,))


def e2e_profile_1(
    size: int, data_id: int, mode: DataIdMode = "both", offset: int = 0
) -> ChecksumSpec:
    """E2E profile 1 (variant 1A: mode both; 1B: alternating; 1C: nibble) [PRS_E2E_00195...].

    The CRC is the first byte of the header; the counter is the low nibble of the second byte, and
    mode nibble uses its high nibble. offset: first byte of the header.
    """
    low, high = _id_bytes(data_id)
    prefixes: tuple[bytes, ...]
    if mode == "both":
        prefixes = (bytes([low, high]),)
    elif mode == "low":
        prefixes = (bytes([low]),)
    elif mode == "nibble":
        prefixes = (bytes([low, 0]),)
    elif mode == "alternating":
        prefixes = tuple(bytes([high if c % 2 else low]) for c in range(E2E_COUNTER_VALUES))
    else:
        raise ConfigError(f"{mode!r} is not a data id mode of E2E profile 1")
    return ChecksumSpec(
        size,
        offset,
        1,
        J1850_POLYNOMIAL,
        prefixes=prefixes,
        counter=_nibble(8 * offset + 8),
        fixed=(_nibble(8 * offset + 12), high & 0xF) if mode == "nibble" else None,
    )


def e2e_profile_2(size: int, data_ids: Sequence[int], offset: int = 0) -> ChecksumSpec:
    """E2E profile 2: CRC-8H2F. The counter is the low nibble of the byte after the CRC. The counter
    selects the data id that is the last input of the CRC."""
    if len(data_ids) != E2E_COUNTER_VALUES:
        raise ConfigError(
            f"E2E profile 2 needs {E2E_COUNTER_VALUES} data ids; {len(data_ids)} are given"
        )
    if not all(0 <= i <= 0xFF for i in data_ids):
        raise ConfigError("a data id of E2E profile 2 must be one byte")
    return ChecksumSpec(
        size,
        offset,
        1,
        H2F_POLYNOMIAL,
        0xFF,
        0xFF,
        suffixes=tuple(bytes([i]) for i in data_ids),
        counter=_nibble(8 * offset + 8),
    )


def e2e_profile_5(size: int, data_id: int, offset: int = 0) -> ChecksumSpec:
    """E2E profile 5: CRC-16 (low byte first); the counter is the byte after the CRC."""
    suffix = bytes(_id_bytes(data_id))
    return ChecksumSpec(size, offset, 2, CCITT_POLYNOMIAL, 0xFFFF, suffixes=(suffix,))


def e2e_profile_11(
    size: int, data_id: int, mode: DataIdMode = "nibble", offset: int = 0
) -> ChecksumSpec:
    """E2E profile 11 (variant 11A: mode both; 11C: nibble). Profile 11 is profile 1 with only two
    modes."""
    if mode not in ("both", "nibble"):
        raise ConfigError(f"{mode!r} is not a data id mode of E2E profile 11")
    return e2e_profile_1(size, data_id, mode, offset)


def in_signal(function: SignalChecksum) -> ChecksumKind:
    """Make a kind that has its own signal and covers identifier bytes and payload."""

    def made(message: Message, options: ChecksumOptions) -> ChecksumSpec:
        if options.signal is None:
            raise ConfigError("needs 'signal:', the signal that contains the checksum")
        field = field_of(message.signal(options.signal))
        identifier = (message.can_id & CAN_EFF_MASK).to_bytes(4, "big")
        position = field.first_bit // 8
        spec = function(message.length, position, identifier[4 - options.id_bytes :])
        if field.length != 8 * spec.width or field.first_bit % 8:
            whole = "one whole byte" if spec.width == 1 else f"{spec.width} whole bytes"
            raise ConfigError(f"signal {options.signal} is not {whole}")
        return replace(spec, byte_order=field.order)

    return ChecksumKind(made, in_signal=function)


E2E_COUNTERS: Mapping[int, HeaderCounter] = {
    1: HeaderCounter(8, 4, 15),
    2: HeaderCounter(8, 4, 16),
    5: HeaderCounter(16, 8, 256),
    11: HeaderCounter(8, 4, 15),
}
"""Alive counters of the AUTOSAR E2E profiles. Profiles 1 and 11 do not use the value 15."""

KINDS: dict[str, ChecksumKind] = {
    "xor": in_signal(xor_checksum),
    "crc8_j1850": in_signal(crc8_j1850),
    "crc16_ccitt": in_signal(crc16_ccitt),
    "e2e_p1": ChecksumKind(
        lambda m, o: e2e_profile_1(m.length, _one_id(o), o.data_id_mode, o.offset), E2E_COUNTERS[1]
    ),
    "e2e_p2": ChecksumKind(
        lambda m, o: e2e_profile_2(m.length, _sixteen_ids(o), o.offset), E2E_COUNTERS[2]
    ),
    "e2e_p5": ChecksumKind(
        lambda m, o: e2e_profile_5(m.length, _one_id(o), o.offset), E2E_COUNTERS[5]
    ),
    "e2e_p11": ChecksumKind(
        lambda m, o: e2e_profile_11(m.length, _one_id(o), o.data_id_mode, o.offset),
        E2E_COUNTERS[11],
    ),
}
"""Kinds by their name in configurations."""

ONE_BYTE_KINDS: Mapping[str, SignalChecksum] = {
    name: kind.in_signal
    for name, kind in KINDS.items()
    if kind.in_signal is not None and kind.in_signal(8, 0, b"").width == 1
}
"""Kinds of one byte over identifier and payload. imucald's own frames may use them."""

NO_CHECKSUM = "none"
"""Kind in configurations for messages without a checksum."""


def _one_id(options: ChecksumOptions) -> int:
    if not isinstance(options.data_id, int):
        raise ConfigError("needs 'data_id:', one number")
    return options.data_id


def _sixteen_ids(options: ChecksumOptions) -> tuple[int, ...]:
    if not isinstance(options.data_id, tuple):
        raise ConfigError("needs 'data_id:', a list of sixteen numbers")
    return options.data_id


def _id_bytes(data_id: int) -> tuple[int, int]:
    if not 0 <= data_id <= 0xFFFF:
        raise ConfigError(f"data id {data_id} is not between 0 and 65535")
    return data_id & 0xFF, data_id >> 8


def _nibble(bit: int) -> Field:
    """Return the nibble at an AUTOSAR bit offset (low nibble first)."""
    return Field(bit, 4, "little_endian")
