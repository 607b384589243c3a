"""Task and outcome of one log. Both are plain data, and are sent between processes as JSON."""

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
"""Kinds of failure of an evaluation. The column `kind` of the table `failures` contains one of
these texts."""

ONCE_MORE: Final = frozenset({"timeout", "memory", "crashed"})
"""Kinds of failure after which a log is evaluated again, alone. The reason may have been a busy
machine."""

OK: Final = "ok"
OTHER_CODE: Final = "other_code"
"""Outcome if a worker that joined later has another version of imucald. The run ends after this
outcome, and the log does not count as failed."""


EVALUATE: Final = "imucald.fleet.evaluation:evaluate"
DIAGNOSE: Final = "imucald.fleet.diagnosed:evaluate_and_diagnose"
"""Function that the child calls with the option `--diagnose`."""


class LogLimits(msgspec.Struct, frozen=True):
    """Limits for one log."""

    memory_bytes: int = 2**30
    """Memory that the evaluation may use in addition to the memory of the program itself
    [bytes]."""
    time_s: float = 900.0
    """Longest duration of the evaluation (wall-clock time) [s]."""


class Task(msgspec.Struct, frozen=True):
    """One log to evaluate.

    source: fsspec URL of the log. bundle: name of the configuration, see `bundle.py`. function: the
    function that the child calls, as "module:name". signals: URL of the folder to which corrected
    signals are written. storage: options of the file systems by protocol; secrets are read from
    environment variables. within: see `Log`.
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
    """Resources that an attempt used. Resources are stored in a separate table, because they differ
    from run to run."""

    wall_s: float = 0.0
    cpu_s: float = 0.0
    peak_memory_bytes: int = 0
    worker: str = ""


class Outcome(msgspec.Struct, frozen=True):
    """The outcome of one attempt. kind: "ok" or one of `FAILURES`.

    log_key: SHA-256 of the log's content (16 hex digits), if the log was read to the end. drive:
    the row of `drives` without the columns that the driver adds. message, traceback: for people.
    """

    kind: str
    message: str = ""
    log_key: str | None = None
    exit_code: int | None = None
    traceback: str = ""
    drive: dict[str, Any] | None = None
    events: list[dict[str, Any]] = []
    cost: Cost = Cost()
