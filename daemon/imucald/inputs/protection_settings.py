"""What the configuration says of a message's protection -> its checker."""

from __future__ import annotations

from imucald.can.dbc.message import Message
from imucald.can.e2e.checksum_engine import ChecksumSpec
from imucald.can.e2e.checksums import KINDS, NO_CHECKSUM, ChecksumKind
from imucald.can.e2e.protection import MessageChecker
from imucald.can.e2e.protection_spec import CounterSpec, ProtectionSpec, counter_of
from imucald.config import MessageProtection
from imucald.core.errors import ConfigError


def checker_for(
    message: Message, protection: MessageProtection | None, least: int | None = None
) -> MessageChecker:
    """Checker of a message; without configuration only its length is judged.

    The database's cycle time alone brings no time-out: many state one for event-driven messages.

    least: bytes that a frame must have; default: those of the message. A checksum is of the whole
    message, so that all must be there.

    Raises ConfigError (without place) where the configuration does not fit the message.
    """
    size = message.length if least is None else least
    if protection is None:
        return MessageChecker(ProtectionSpec(size=size))
    checksum, kind = _checksum(message, protection)
    counter = _counter(message, protection, kind)
    if checksum is not None:
        size = message.length
    elif counter is not None:
        size = max(size, counter.field.end_byte)
    return MessageChecker(
        ProtectionSpec(
            size=size,
            counter=counter,
            checksum=checksum,
            cycle_time=protection.cycle_time or message.cycle_time,
            timeout_cycles=protection.timeout_cycles,
            recovery=protection.recover_after,
            cycle_is_sure=protection.cycle_time is not None,
        )
    )


def _checksum(
    message: Message, protection: MessageProtection
) -> tuple[ChecksumSpec | None, ChecksumKind | None]:
    settings = protection.checksum
    if settings is None or settings.kind == NO_CHECKSUM:
        return None, None
    kind = KINDS[settings.kind]
    try:
        return kind.make(message, settings), kind
    except ConfigError as error:
        raise ConfigError(f"checksum {settings.kind}: {error}") from None


def _counter(
    message: Message, protection: MessageProtection, kind: ChecksumKind | None
) -> CounterSpec | None:
    header = None if kind is None else kind.counter
    counter = protection.counter
    if counter is not None:
        modulus = counter.modulus
        if modulus is None and header is not None:  # profiles 1 and 11 wrap at 14
            modulus = header.modulus
        return counter_of(message.signal(counter.signal), modulus, counter.max_step)
    if header is None or protection.checksum is None:
        return None
    return header.at(8 * protection.checksum.offset)
