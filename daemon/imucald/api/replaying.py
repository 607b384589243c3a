"""`imucald.replay`: run recorded logs through the engine of the daemon."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import BinaryIO, Literal, overload

from imucald.api.blas_threads import on_one_thread
from imucald.api.configuration import Configuration, PathLike
from imucald.api.drive import DriveResult
from imucald.api.drives import DriveSet, between_drives
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
    """Replay logs. The result is bit-identical to the result of `imucald replay`.

    config: a configuration, or the name of its file.

    log: a file's name, or a file that is open for reading bytes (candump text, plain or gzip). One
    log is one drive, and the result is a DriveResult. In a list, each log is one drive that is
    replayed separately, and the result is a DriveSet. With `joined`, the list contains the pieces
    of one recording in their order, and the result is a DriveResult.

    signals: whether corrected and raw samples are kept (about 100 bytes per sensor sample). If
    False, the result has only mount, history and events. progress: called with the bytes read and
    the total bytes (or None). strict: the first bad line raises LogError instead of being counted.

    Raises ConfigError if the configuration cannot be used. Raises LogError for a log that cannot be
    read or contains no CAN frame. Of several drives, such a log is in `DriveSet.failed`, and
    LogError is raised only with `strict` or if no log could be read.
    """
    config = Configuration.of(config)
    if not isinstance(log, list | tuple):
        return _replayed(config, [log], signals, progress, strict)
    if not log:
        raise LogError("there is no log to replay")
    if joined:
        return _replayed(config, log, signals, progress, strict)
    drives: list[DriveResult] = []
    failed: list[tuple[str, str]] = []
    for one in log:
        try:
            drives.append(_replayed(config, [one], signals, progress, strict))
        except LogError as error:
            if strict:
                raise
            is_name = isinstance(one, str | os.PathLike)
            name = one if is_name else getattr(one, "name", "<open file>")
            failed.append((str(name), str(error)))
    if not drives:
        raise LogError("; ".join(reason for _, reason in failed))
    return DriveSet(tuple(drives), *between_drives(drives), tuple(failed))


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
