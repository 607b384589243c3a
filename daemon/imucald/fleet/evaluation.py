"""The work of a child process: evaluate one log, and return the result as a row."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from imucald.api.configuration import Configuration
from imucald.api.replaying import replay
from imucald.core.errors import (
    ConfigError,
    DatabaseError,
    LogError,
    NoFramesError,
)
from imucald.fleet.bundle import code_hash, load_bundle
from imucald.fleet.drive_row import drive_row, event_rows, known_times
from imucald.fleet.fetch import NoRegularFileError, StorageError, local_copy
from imucald.fleet.task import OK, OTHER_CODE, Outcome, Task

Also = Callable[[Configuration, Path], dict[str, Any]]

NOT_OURS = "the log has no usable frame of this configuration; 'imucald check' shows more"


def evaluate(task: Task, also: Also | None = None) -> Outcome:
    """Replay a single log without a saved state, and return the outcome.

    also: function that returns additional columns of the drive.

    The row depends only on the content of the log, the configuration and the code. The row does not
    depend on other drives of the vehicle, the order of the logs or the machine.
    """
    if task.code and task.code != code_hash():
        return Outcome(OTHER_CODE)
    try:
        config = load_bundle(task.bundle)
        with local_copy(task.source, task.storage, task.within) as (path, key):
            return _replayed(task, config, path, key, also)
    except StorageError as error:
        return Outcome("storage", str(error))
    except NoRegularFileError as error:
        return Outcome("unreadable", str(error))
    except (ConfigError, DatabaseError) as error:
        return Outcome("config", str(error))


def _replayed(
    task: Task, config: Configuration, path: Path, key: str, also: Also | None
) -> Outcome:
    try:
        drive = replay(config, path, signals=task.signals is not None)
    except NoFramesError as error:
        return Outcome("no_frames", _named(error, path, task), key)
    except LogError as error:
        return Outcome("unreadable", _named(error, path, task), key)
    if drive.frames["used"] == 0:
        return Outcome("no_frames", f"{task.source}: {NOT_OURS}", key)
    start, _ = known_times(drive)
    if task.signals is not None:
        from imucald.fleet.signals import write_signals  # noqa: PLC0415 - loads pyarrow: 0.2 s

        write_signals(drive, task, key, start)
    events = event_rows(drive.tables["events"], start is not None)
    row = drive_row(drive, config.loaded.config)
    if also is not None:
        row |= also(config, path)
    return Outcome(OK, log_key=key, drive=row, events=events)


def _named(error: LogError, path: Path, task: Task) -> str:
    """Return the text of an error, with the address of the log instead of the path of its local
    copy."""
    return str(error).replace(str(path), task.source)


code_hash()  # once in the template, so that its copies have it
