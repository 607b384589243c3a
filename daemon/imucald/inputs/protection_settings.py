"""What the configuration says of a message's protection -> its checker."""

from __future__ import annotations

from imucald.can.columns import CAN_EFF_MASK
from imucald.can.dbc.bits import field_of
from imucald.can.dbc.database import Message
from imucald.can.e2e import checksums
from imucald.can.e2e.protection import (
    CounterSpec,
    MessageChecker,
    ProtectionSpec,
    counter_of,
    e2e_counter,
)
from imucald.can.e2e.protection_spec import E2E_COUNTER_MODULUS
from imucald.config import Checksum, MessageProtection
from imucald.core.errors import ConfigError

_E2E = {"e2e_p1": 1, "e2e_p2": 2, "e2e_p5": 5, "e2e_p11": 11}
_COUNTER_BIT = {1: 8, 2: 8, 5: 16, 11: 8}
"""Place of the counter behind the start of each profile's header [bit]."""


def checker_for(message: Message, protection: MessageProtection | None) -> MessageChecker:
    """Guard of a message; without configuration only its length is judged.

    The database's cycle time alone brings no time-out: many state one for event-driven messages.

    Raises ConfigError (without place) where the configuration does not fit the message.
    """
    if protection is None:
        return MessageChecker(ProtectionSpec(size=message.length))
    checksum, profile = _checksum(message, protection.checksum)
    return MessageChecker(
        ProtectionSpec(
            size=message.length,
            counter=_counter(message, protection, profile),
            checksum=checksum,
            cycle_time=protection.cycle_time or message.cycle_time,
            timeout_cycles=protection.timeout_cycles,
            recovery=protection.recover_after,
        )
    )


def _counter(
    message: Message, protection: MessageProtection, profile: int | None
) -> CounterSpec | None:
    counter = protection.counter
    if counter is not None:
        signal = message.signal(counter.signal)
        modulus = counter.modulus
        if modulus is None and profile is not None:  # profiles 1 and 11 wrap at 14
            modulus = E2E_COUNTER_MODULUS[profile]
        return counter_of(signal, modulus, counter.max_step)
    if profile is None or protection.checksum is None:
        return None
    bit = 8 * protection.checksum.offset + _COUNTER_BIT[profile]
    return e2e_counter(profile, bit, max_jump=1)


def _checksum(
    message: Message, checksum: Checksum | None
) -> tuple[checksums.ChecksumSpec | None, int | None]:
    if checksum is None or checksum.kind == "none":
        return None, None
    profile = _E2E.get(checksum.kind)
    if profile is not None:
        return _e2e(message, checksum, profile), profile
    if checksum.signal is None:
        raise ConfigError(f"checksum {checksum.kind} needs 'signal:', the signal it stands in")
    field = field_of(message.signal(checksum.signal))
    if field.length != 8 or field.first_bit % 8:
        raise ConfigError(f"checksum signal {checksum.signal} is not one whole byte")
    identifier = (message.can_id & CAN_EFF_MASK).to_bytes(4, "big")
    id_bytes = identifier[4 - checksum.id_bytes :]
    make = checksums.crc8_j1850 if checksum.kind == "crc8_j1850" else checksums.xor_checksum
    return make(message.length, field.first_bit // 8, id_bytes), None


def _e2e(message: Message, checksum: Checksum, profile: int) -> checksums.ChecksumSpec:
    bit = 8 * checksum.offset
    data_id = checksum.data_id
    if profile == 2:
        if not isinstance(data_id, tuple):
            raise ConfigError("E2E profile 2 needs 'data_id:', a list of sixteen numbers")
        return checksums.e2e_profile_2(message.length, data_id, bit)
    if not isinstance(data_id, int):
        raise ConfigError(f"E2E profile {profile} needs 'data_id:', one number")
    if profile == 5:
        return checksums.e2e_profile_5(message.length, data_id, bit)
    make = checksums.e2e_profile_1 if profile == 1 else checksums.e2e_profile_11
    return make(message.length, data_id, checksum.data_id_mode, bit, bit + 8, bit + 12)
