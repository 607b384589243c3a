"""All errors that imucald raises on purpose. Each class states when it is raised.

Any other exception that reaches the user is a defect. The texts of `ImucaldError` are written for
users. These texts name the place (file, line, key, message) and the remedy. The command line prints
them without a traceback.
"""

from __future__ import annotations


class ImucaldError(Exception):
    """Base of all errors that imucald raises on purpose."""

    exit_status = 1
    """Exit status of a command that this error ends."""


class ConfigError(ImucaldError):
    """The configuration (a YAML file or a file named in it) is wrong. The text states place, reason
    and remedy.
    """


class DatabaseError(ImucaldError):
    """A CAN database cannot be loaded, or lacks a requested message or signal."""


class DecodeError(ImucaldError):
    """A frame does not fit its message (length, multiplexer). `reason` is the name under which such
    frames are counted."""

    def __init__(self, reason: str, text: str) -> None:
        super().__init__(text)
        self.reason = reason

    def __reduce__(self) -> tuple[type[DecodeError], tuple[str, str]]:
        return type(self), (self.reason, str(self))


class EncodeError(ImucaldError):
    """A value cannot be written into its signal (range, NaN, unknown name)."""


class LogError(ImucaldError):
    """A recorded log cannot be opened or read. In strict mode: the log has a bad line."""


class NoFramesError(LogError):
    """A readable log contains no CAN frame."""


class LinkError(ImucaldError):
    """A CAN interface cannot be opened, or is lost and cannot recover."""


class EstimateError(ImucaldError):
    """Numbers passed to an estimator are invalid (shape, order, not finite)."""
