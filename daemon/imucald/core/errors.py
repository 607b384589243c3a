"""Every error imucald raises on purpose, in one family. The file reads as a table of contents.

Anything else that escapes is a defect. `ImucaldError` texts are made for people: they name the
place (file, line, key, message) and the remedy, and the command line prints them without a trace.
"""

from __future__ import annotations


class ImucaldError(Exception):
    """Base of all errors that imucald raises on purpose."""


class ConfigError(ImucaldError):
    """The configuration (YAML, or what it refers to) is wrong: place, reason and remedy."""


class DatabaseError(ImucaldError):
    """A CAN database cannot be loaded, or lacks a message or signal that is asked for."""


class DecodeError(ImucaldError):
    """A frame does not fit its message (length, multiplexer); `reason` is the counter's name."""

    def __init__(self, reason: str, text: str) -> None:
        super().__init__(text)
        self.reason = reason

    def __reduce__(self) -> tuple[type[DecodeError], tuple[str, str]]:
        return type(self), (self.reason, str(self))


class EncodeError(ImucaldError):
    """A value cannot be written into its signal (range, NaN, unknown name)."""


class LogError(ImucaldError):
    """A recorded log cannot be opened or read, or has a bad line and strict reading was asked."""


class NoFramesError(LogError):
    """A log that can be read, but holds no CAN frame."""


class LinkError(ImucaldError):
    """A CAN interface cannot be opened or has gone in a way that cannot be healed."""


class EstimateError(ImucaldError):
    """Numbers handed to an estimator break its contract (shape, order, not finite)."""
