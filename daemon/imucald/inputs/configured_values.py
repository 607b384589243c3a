"""Numbers of a configuration that a signal is compared with: only such as it can have."""

from __future__ import annotations

import numpy as np

from imucald.can.dbc.message import Signal
from imucald.can.dbc.resolved_signal import raw_limits, scaling_of
from imucald.core.errors import ConfigError


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
        raise ConfigError(f"{signal.name} is never {value:g}; the nearest it can be is {found:g}")
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
        text += f"; the same bits as a signed number are {raw - size}"
    raise ConfigError(text)
