"""Task and outcome of one log, exchanged with a worker: plain data, as JSON between processes."""

from __future__ import annotations

from typing import Any, Final

import msgspec

FAILURES: Final = (
    "unreadable",  # no regular file, or no log at all
    "no_frames",  # a log, but without a usable frame of this configuration
    "config",  # the configuration or a database is wrong
    "storage",  # the log could not be fetched
    "timeout",  # exceeded the time limit
    "memory",  # exceeded the memory limit
    "crashed",  # its process died
    "bug",  # an error that imucald does not raise on purpose
)
"""How the evaluation of a log can fail. Its row in `failures` has one of these as `kind`."""

ONCE_MORE: Final = frozenset({"timeout", "memory", "crashed"})
"""Failures that are tried again, one log at a time: the reason may have been a busy machine."""

OK: Final = "ok"
OTHER_CODE: Final = "other_code"
"""A worker that joined later has another version of imucald: the run ends without blaming a log."""


EVALUATE: Final = "imucald.fleet.evaluation:evaluate"
DIAGNOSE: Final = "imucald.fleet.diagnosed:evaluate_and_diagnose"
"""Default function that the child calls."""


class LogLimits(msgspec.Struct, frozen=True):
    """Limits for one log."""

    memory_bytes: int = 2**30
    """In addition to the memory of the program itself."""
    time_s: float = 900.0
    """Wall-clock time [s]."""


class Task(msgspec.Struct, frozen=True):
    """One log to evaluate.

    source: its fsspec URL. bundle: name of the configuration, see `bundle.py`. function: the
    function that the child calls, as "module:name". signals: URL of the folder that corrected
    signals go to. storage: options of the file systems by protocol; secrets come from the
    environment. within: see `Log`.
    """

    source: str
    bundle: str
    code: str = ""
    vehicle: str = ""
    date: str | None = None
    bytes: int = 0
    limits: LogLimits = LogLimits()
    function: str = EVALUATE
    signals: str | None = None
    storage: dict[str, dict[str, Any]] = {}
    within: str | None = None


class Cost(msgspec.Struct, frozen=True):
    """Resources used by an attempt; they differ from run to run, so they have a separate table."""

    wall_s: float = 0.0
    cpu_s: float = 0.0
    peak_memory_bytes: int = 0
    worker: str = ""


class Outcome(msgspec.Struct, frozen=True):
    """The outcome of one attempt; kind is "ok" or one of `FAILURES`.

    log_key: SHA-256 of the log's content (16 hex digits), if it was read to the end. drive: the row
    of `drives` without the columns that the driver adds. message, traceback: for people.
    """

    kind: str
    message: str = ""
    log_key: str | None = None
    exit_code: int | None = None
    traceback: str = ""
    drive: dict[str, Any] | None = None
    events: list[dict[str, Any]] = []
    cost: Cost = Cost()


def encoded(value: Task | Outcome) -> bytes:
    """A task or outcome as JSON."""
    return msgspec.json.encode(value)
