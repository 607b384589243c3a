"""`imucald.replay`: recorded logs through the engine of the daemon."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from imucald.api.configuration import Configuration
from imucald.api.drive import DriveResult
from imucald.api.logs import LogSource
from imucald.api.run import Progress, Run


def replay(
    config: Configuration,
    log: LogSource,
    *,
    signals: bool = True,
    progress: Progress | None = None,
    strict: bool = False,
) -> DriveResult:
    """Replay one recording; the result is that of `imucald replay`, bit for bit.

    log: its name, an open file of bytes (candump), or a list of these: the pieces of one recording
    in their order. Several drives are `replay_drives`. signals: keep corrected and raw samples
    (about 100 bytes each); without, the result has mount, history and events only. progress: called
    with bytes read, and bytes in all or None. strict: the first bad line raises LogError, instead
    of being counted.

    Raises ConfigError where the configuration cannot be used, LogError for a log that cannot be
    read or holds no CAN frame.
    """
    run = Run(config, _pieces(log), signals, progress, strict)
    for _ in run.chunks():
        pass
    return run.result()


def _pieces(log: LogSource | Sequence[Any]) -> Sequence[Any]:
    return log if isinstance(log, list | tuple) else [log]
