"""A short simulated drive as a log, and what the Python API makes of it, once per process."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import imucald
from imucald.can.logs.log_reader import CandumpWriter
from simulated_bus import CONFIG, drive_frames


@cache
def log() -> Path:
    """Four minutes of driving, as candump text."""
    path = Path(tempfile.mkdtemp(prefix="imucald-api-")) / "drive.log"
    with CandumpWriter(path) as writer:
        writer.write_columns(drive_frames())
    return path


@cache
def config() -> imucald.Config:
    """The configuration of that drive."""
    return imucald.Config.load(CONFIG)


@cache
def drive() -> imucald.DriveResult:
    """The drive with all its signals."""
    return imucald.replay(config(), log())
