"""Raw values that a database's value table calls no value at all.

J1939 and the databases of vehicle makers name them: SNA, not available, invalid, error, init; in
German ones ungueltig, nicht verfuegbar, Fehler. A signal carries them instead of a value.

Numbers of a configuration that a signal is compared with: only such as it can have.

What the configuration says of a message's protection -> its checker.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from imucald.can.dbc.message import Message, Signal
from imucald.can.dbc.resolved_signal import raw_limits, scaling_of
from imucald.can.e2e.checksum_engine import ChecksumSpec
from imucald.can.e2e.checksums import KINDS, NO_CHECKSUM, ChecksumKind
from imucald.can.e2e.protection import MessageChecker
from imucald.can.e2e.protection_spec import CounterSpec, ProtectionSpec, counter_of
from imucald.config import MessageProtection
from imucald.core.errors import ConfigError

_NAMES = re.compile(
    r"\b(sna|n a|not available|notavailable|unavailable|not valid|invalid|error|errorvalue|init"
    r"|initial|initvalue|initiali[sz](e|ed|ing|ation)|ungueltig|ungültig|nicht verfuegbar"
    r"|nicht verfügbar|fehler|fehlerwert|initwert|initialwert)\b"
)
_NO = re.compile(r"^(no|kein|keine|not in|without)\b")


def is_no_value(name: str) -> bool:
    """Whether an entry of a value table says that there is no value: "SNA", "NotAvailable"."""
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
    words = re.sub(r"[\W_]+", " ", words).strip().lower()
    return bool(_NAMES.search(words)) and not _NO.match(words)


def no_values(choices: Mapping[int, str]) -> tuple[int, ...]:
    """The raw values of a table that are none, in order."""
    return tuple(sorted(raw for raw, name in choices.items() if is_no_value(name)))


def as_decoded(signal: Signal, value: float) -> float:
    """What the decoder makes of the raw number that a person calls `value` [the signal's unit].

    The two differ in the last bit, such as 0.3 from 3 times 0.1. Raises ConfigError where no raw
    number gives it: the comparison would never hold.
    """
    if signal.is_float or not signal.scale:
        return value
    try:
        low, high = raw_limits(signal)
        scale, offset = float(signal.scale), float(signal.offset)
        raw = min(max(round((value - offset) / scale), low), high)
        found = float(scaling_of(signal, signal.name).column(np.array([raw]))[0])
    except (OverflowError, ValueError):  # infinite, no number, or beyond all that a bus carries
        raise ConfigError(f"{signal.name} is never {value:g}") from None
    if abs(found - value) > 1e-6 * abs(scale):
        raise ConfigError(
            f"{signal.name} is never {value:g}; its nearest possible value is {found:g}"
        )
    return found


def check_raw(signal: Signal, raw: int) -> int:
    """The raw number; raises ConfigError where the signal's bits do not hold it."""
    if signal.is_float or signal.length < 1:  # who decodes the signal refuses the second
        return raw
    low, high = raw_limits(signal)
    if low <= raw <= high:
        return raw
    text = f"{signal.name} is never {raw}: its raw numbers are {low} to {high}"
    size = 1 << signal.length
    if signal.is_signed and high < raw < size:
        text += f"; as a signed number, these bits are {raw - size}"
    raise ConfigError(text)


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
