"""Settings of signals: raw values that mean "no value", configured numbers, and the protection of
messages.

The value table of a database names raw values that mean "no value": SNA, not available, invalid,
error, init; in German ungueltig, nicht verfuegbar, Fehler. A signal has such a raw value if there
is no measured value.

A configured number that is compared with a signal must be a value that the signal can have.

`checker_for` makes the checker of a message from the configuration of its protection.
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
    """True if an entry of a value table means "no value", such as "SNA" or "NotAvailable"."""
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
    words = re.sub(r"[\W_]+", " ", words).strip().lower()
    return bool(_NAMES.search(words)) and not _NO.match(words)


def no_values(choices: Mapping[int, str]) -> tuple[int, ...]:
    """Return the raw values of a value table that mean "no value", in order."""
    return tuple(sorted(raw for raw, name in choices.items() if is_no_value(name)))


def as_decoded(signal: Signal, value: float) -> float:
    """Return the decoder's result for the raw number that belongs to `value` [the signal's unit].

    The result may differ from `value` in the last bit, just as 3 times 0.1 differs from 0.3. Raises
    ConfigError if no raw number gives this value, because the comparison would never be true.
    """
    if signal.is_float or not signal.scale:
        return value
    try:
        low, high = raw_limits(signal)
        scale, offset = float(signal.scale), float(signal.offset)
        raw = min(max(round((value - offset) / scale), low), high)
        found = float(scaling_of(signal, signal.name).column(np.array([raw]))[0])
    except (OverflowError, ValueError):  # infinite, NaN, or too large for any signal
        raise ConfigError(f"{signal.name} is never {value:g}") from None
    if abs(found - value) > 1e-6 * abs(scale):
        raise ConfigError(
            f"{signal.name} is never {value:g}; its nearest possible value is {found:g}"
        )
    return found


def check_raw(signal: Signal, raw: int) -> int:
    """Return `raw`. Raises ConfigError if this number does not fit the bits of the signal."""
    if signal.is_float or signal.length < 1:  # decoding refuses a length below 1
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
    """Make the checker of a message. Without configuration, only the length is checked.

    A cycle time that only the database states gives no time-out, because many databases state a
    cycle time for event-driven messages.

    least: shortest accepted frame [bytes]; default: the length of the message. If the message has a
    checksum, all bytes must be present.

    Raises ConfigError (without place) if the configuration does not fit the message.
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
