"""How a message is protected: length, alive counter, checksum, cycle time."""

from __future__ import annotations

from msgspec import Struct

from imucald.can.dbc.bits import MAX_FRAME_BYTES, Field, field_of
from imucald.can.dbc.message import Signal
from imucald.can.e2e.checksum_engine import ChecksumSpec
from imucald.core.errors import ConfigError

DEFAULT_RECOVERY = 3
"""Good frames in a row after a fault before a message is trusted again."""

DEFAULT_TIMEOUT_CYCLES = 10.0
"""Silence, in cycle times, after which the counter starts again."""

COUNTER_BITS = 56
"""Sums of longer ones' steps over a chunk of frames do not fit 64 bits. AUTOSAR's have 32."""

_FD_LENGTHS = (8, 12, 16, 20, 24, 32, 48, 64)
"""Payloads that CAN FD has besides those of classic CAN [bytes] (ISO 11898-1)."""


class CounterSpec(Struct, frozen=True):
    """An alive counter: its bits, its number of values, the largest step accepted.

    max_jump: None, every step forward that the time since the last frame has room for.
    """

    field: Field
    modulus: int
    max_jump: int | None = None

    def __post_init__(self) -> None:
        if self.field.length > COUNTER_BITS:
            text = f"a counter may have {COUNTER_BITS} bits at most, not {self.field.length}"
            raise ConfigError(text)
        if not 2 <= self.modulus <= 1 << self.field.length:
            raise ConfigError(
                f"a counter of {self.field.length} bits does not have {self.modulus} values"
            )
        if self.max_jump is not None and not 1 <= self.max_jump < self.modulus:
            raise ConfigError(
                f"max_step {self.max_jump} is not possible with a counter of {self.modulus} values"
            )


class ProtectionSpec(Struct, frozen=True):
    """How one message is protected.

    size: bytes it has. cycle_time [s]: None, no time-out. cycle_is_sure: whether the cycle is held
    against the very first frames, or tried first.
    """

    size: int
    counter: CounterSpec | None = None
    checksum: ChecksumSpec | None = None
    cycle_time: float | None = None
    timeout_cycles: float = DEFAULT_TIMEOUT_CYCLES
    recovery: int = DEFAULT_RECOVERY
    cycle_is_sure: bool = True

    def __post_init__(self) -> None:
        if not 0 <= self.size <= MAX_FRAME_BYTES:
            raise ConfigError(f"a message of {self.size} bytes does not fit a CAN frame")
        if self.counter is not None and self.counter.field.end_byte > self.size:
            raise ConfigError(f"the counter is outside a message of {self.size} bytes")
        if self.checksum is not None and self.checksum.size > self.size:
            raise ConfigError(f"the checksum is outside a message of {self.size} bytes")
        if self.recovery < 0:
            raise ConfigError("recovery frames cannot be negative")
        if self.cycle_time is not None and not self.cycle_time * self.timeout_cycles > 0.0:
            raise ConfigError("cycle time and time-out must be positive")

    @property
    def longest(self) -> int:
        """Bytes of the longest frame that is taken: what lies beyond a checksum, nobody checks."""
        if self.checksum is None:
            return MAX_FRAME_BYTES
        if self.size <= _FD_LENGTHS[0]:
            return self.size
        return next(length for length in _FD_LENGTHS if length >= self.size)

    @property
    def timeout(self) -> float | None:
        """Silence after which the counter starts again [s]; None: the cycle time is not known."""
        return None if self.cycle_time is None else self.cycle_time * self.timeout_cycles


def counter_of(
    signal: Signal, modulus: int | None = None, max_jump: int | None = None
) -> CounterSpec:
    """Alive counter in a signal's bits; it wraps at the bits' end unless `modulus` is given."""
    return CounterSpec(field_of(signal), modulus or 1 << signal.length, max_jump)
