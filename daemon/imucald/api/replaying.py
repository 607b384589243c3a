"""`imucald.replay`: recorded logs through the engine of the daemon."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import BinaryIO, Literal, overload

from imucald.api.between_drives import notes_between
from imucald.api.blas_threads import on_one_thread
from imucald.api.configuration import Configuration, PathLike
from imucald.api.drive import DriveResult
from imucald.api.drives import DriveSet
from imucald.api.logs import LogSource
from imucald.api.run import Progress, ReplayRun, require_frames
from imucald.core.errors import LogError

OneLog = str | os.PathLike[str] | BinaryIO
SeveralLogs = list[LogSource] | tuple[LogSource, ...]


@overload
def replay(
    config: Configuration | PathLike,
    log: OneLog,
    *,
    joined: bool = False,
    signals: bool = True,
    progress: Progress | None = None,
    strict: bool = False,
) -> DriveResult: ...


@overload
def replay(
    config: Configuration | PathLike,
    log: SeveralLogs,
    *,
    joined: Literal[True],
    signals: bool = True,
    progress: Progress | None = None,
    strict: bool = False,
) -> DriveResult: ...


@overload
def replay(
    config: Configuration | PathLike,
    log: SeveralLogs,
    *,
    joined: Literal[False] = False,
    signals: bool = True,
    progress: Progress | None = None,
    strict: bool = False,
) -> DriveSet: ...


def replay(
    config: Configuration | PathLike,
    log: OneLog | SeveralLogs,
    *,
    joined: bool = False,
    signals: bool = True,
    progress: Progress | None = None,
    strict: bool = False,
) -> DriveResult | DriveSet:
    """Replay logs; the result is that of `imucald replay`, bit for bit.

    config: a configuration, or its file's name.

    log: a file's name, or a file that is open for reading bytes (candump text, plain or gzip): one
    drive, a DriveResult. A list of them is as many drives, each replayed on its own: a DriveSet;
    with `joined` they are the pieces of one recording, in their order: a DriveResult.

    signals: keep corrected and raw samples (about 100 bytes for each of the sensor's); without
    them the result has mount, history and events. progress: called with bytes read, and bytes in
    all or None. strict: the first bad line raises LogError, instead of being counted.

    Raises ConfigError where the configuration cannot be used, LogError for a log that cannot be
    read or holds no CAN frame.
    """
    config = Configuration.of(config)
    if not isinstance(log, list | tuple):
        return _replayed(config, [log], signals, progress, strict)
    if not log:
        raise LogError("there is no log to replay")
    if joined:
        return _replayed(config, log, signals, progress, strict)
    drives = tuple(_replayed(config, [one], signals, progress, strict) for one in log)
    return DriveSet(drives, notes_between(drives))


@on_one_thread
def _replayed(
    config: Configuration,
    logs: Sequence[LogSource],
    signals: bool,
    progress: Callable[[int, int | None], None] | None,
    strict: bool,
) -> DriveResult:
    run = ReplayRun(config, logs, signals, progress, strict)
    for _ in run.chunks():
        pass
    return require_frames(run.result())
