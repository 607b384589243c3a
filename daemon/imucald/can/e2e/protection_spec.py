"""The protection of a message: length, alive counter, checksum, cycle time."""

from __future__ import annotations

from msgspec import Struct

from imucald.can.columns import FD_BYTES, FD_LENGTHS
from imucald.can.dbc.bits import Field, field_of
from imucald.can.dbc.message import Signal
from imucald.can.e2e.checksum_engine import ChecksumSpec
from imucald.core.errors import ConfigError

DEFAULT_RECOVERY = 3
"""Number of consecutive good frames after a fault until a message is trusted again."""

DEFAULT_TIMEOUT_CYCLES = 10.0
"""Silence, in cycle times, after which the counter may start at any value."""

COUNTER_BITS = 32
"""Largest counter [bits], as in AUTOSAR E2E."""


class CounterSpec(Struct, frozen=True):
    """An alive counter: its bits, its number of values, the largest step accepted.

    max_jump: None accepts every step forward that is possible in the time since the last frame.
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
    """The protection of one message.

    size: length [bytes]. cycle_time [s]: None means no time-out. cycle_is_sure: if True, the cycle
    is checked from the first frames on; if False, the stated cycle is tried first.
    """

    size: int
    counter: CounterSpec | None = None
    checksum: ChecksumSpec | None = None
    cycle_time: float | None = None
    timeout_cycles: float = DEFAULT_TIMEOUT_CYCLES
    recovery: int = DEFAULT_RECOVERY
    cycle_is_sure: bool = True

    def __post_init__(self) -> None:
        if not 0 <= self.size <= FD_BYTES:
            raise ConfigError(f"a message of {self.size} bytes does not fit a CAN frame")
        if self.counter is not None and self.counter.field.end_byte > self.size:
            raise ConfigError(f"the counter is outside a message of {self.size} bytes")
        if self.checksum is not None and self.checksum.size > self.size:
            raise ConfigError(f"the checksum is outside a message of {self.size} bytes")
        if self.recovery < 0:
            raise ConfigError("recover_after must not be negative")
        if self.cycle_time is not None and not self.cycle_time * self.timeout_cycles > 0.0:
            raise ConfigError("cycle time and time-out must be positive")

    @property
    def longest(self) -> int:
        """Longest accepted frame [bytes], because bytes after the checked range are unprotected."""
        if self.checksum is None:
            return FD_BYTES
        if self.size <= FD_LENGTHS[0]:
            return self.size
        return next(length for length in FD_LENGTHS if length >= self.size)

    @property
    def timeout(self) -> float | None:
        """Silence after which the counter may restart [s]; None if the cycle time is not known."""
        return None if self.cycle_time is None else self.cycle_time * self.timeout_cycles


def counter_of(
    signal: Signal, modulus: int | None = None, max_jump: int | None = None
) -> CounterSpec:
    """Make an alive counter from a signal. The counter wraps at its largest value or at
    `modulus`."""
    return CounterSpec(field_of(signal), modulus or 1 << signal.length, max_jump)
