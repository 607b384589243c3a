"""One log to one row: what the child process does."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from imucald.can.logs.log_reader import LogReader
from imucald.config import LoadedConfig
from imucald.core.errors import ConfigError, DatabaseError, LogError
from imucald.fleet.bundle import code_hash, load_bundle
from imucald.fleet.drive_row import drive_row, event_rows
from imucald.fleet.fetch import NoRegularFileError, StorageError, local_copy
from imucald.fleet.task import OK, Outcome, Task
from imucald.runtime.replay import Replay
from imucald.runtime.session import make_engine


def evaluate(task: Task) -> Outcome:
    """Replay a log by itself, cold, and say what came of it.

    The row depends on the log's content, the configuration and the code alone: not on the vehicle's
    other drives, the order or the machine.
    """
    if task.code and task.code != code_hash():
        return Outcome("config", "this worker has other code of imucald than the driver")
    try:
        loaded = load_bundle(task.bundle)
        with local_copy(task.source, task.storage) as (path, key, size):
            return _replayed(task, loaded, path, key, size)
    except StorageError as error:
        return Outcome("storage", str(error))
    except NoRegularFileError as error:
        return Outcome("unreadable", str(error))
    except (ConfigError, DatabaseError) as error:
        return Outcome("config", str(error))


def _replayed(task: Task, loaded: LoadedConfig, path: Path, key: str, size: int) -> Outcome:
    engine = make_engine(loaded)
    reader = LogReader([path], engine.router.matches)
    try:
        result = Replay(engine, reader).run()
    except LogError as error:
        return Outcome("unreadable", str(error).replace(str(path), task.source), key)
    if reader.frames_read == 0:
        return Outcome("no_frames", f"{task.source}: holds no CAN frame", key)
    if engine.router.used == 0:
        text = "the log has no usable frame of this configuration; 'imucald check' tells more"
        return Outcome("no_frames", f"{task.source}: {text}", key)
    covariance = engine.pipeline.estimator.estimate().covariance
    in_deg2 = None if covariance is None else np.degrees(np.degrees(covariance))
    row = drive_row(result, in_deg2, loaded.config, reader.first_stamp)
    return Outcome(OK, log_key=key, drive=row, events=event_rows(result, reader.first_stamp))
