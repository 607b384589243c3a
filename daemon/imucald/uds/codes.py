"""Numbers of ISO 14229-1: services, negative responses, sessions."""

from __future__ import annotations

import enum
from typing import Final


class Sid(enum.IntEnum):
    """Supported services."""

    SESSION_CONTROL = 0x10
    CLEAR_DTCS = 0x14
    READ_DTCS = 0x19
    READ_DATA = 0x22
    SECURITY_ACCESS = 0x27
    ROUTINE_CONTROL = 0x31
    TESTER_PRESENT = 0x3E


class Nrc(enum.IntEnum):
    """Reasons for refusing a request (negative response codes)."""

    SERVICE_NOT_SUPPORTED = 0x11
    SUB_FUNCTION_NOT_SUPPORTED = 0x12
    INCORRECT_LENGTH = 0x13
    RESPONSE_TOO_LONG = 0x14
    CONDITIONS_NOT_CORRECT = 0x22
    REQUEST_SEQUENCE_ERROR = 0x24
    OUT_OF_RANGE = 0x31
    SECURITY_ACCESS_DENIED = 0x33
    INVALID_KEY = 0x35
    EXCEEDED_ATTEMPTS = 0x36
    DELAY_NOT_EXPIRED = 0x37
    SUB_FUNCTION_NOT_IN_SESSION = 0x7E
    SERVICE_NOT_IN_SESSION = 0x7F


class Session(enum.IntEnum):
    """Sessions that can be entered."""

    DEFAULT = 0x01
    EXTENDED = 0x03


NEGATIVE: Final = 0x7F
"""First byte of a negative response."""
POSITIVE: Final = 0x40
"""Number that is added to the service id in a positive response. This bit is 0 in every request."""
SUPPRESS: Final = 0x80
"""Bit of a sub-function with which the tester suppresses the positive response."""

Answer = bytes | Nrc
"""Answer of a service: the response without the service id, or the negative response code."""
