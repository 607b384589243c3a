"""`imucald replay --report DIR`: the page about a drive, made beside the replay."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from imucald import __version__
from imucald.can.columns import FrameColumns
from imucald.can.logs.log_reader import LogReader
from imucald.commands.files import write_text
from imucald.config import LoadedConfig
from imucald.core.errors import ImucaldError
from imucald.report.drive_history import DriveHistory
from imucald.report.page import About, require_libraries
from imucald.report.replay_page import replay_page
from imucald.runtime.engine import Engine
from imucald.runtime.pipeline import Snapshot
from imucald.runtime.replay import Sink

PAGE = "index.html"


class _WatchedReader(LogReader):
    """A reader whose chunks the history sees before the engine does."""

    def __init__(self, history: DriveHistory, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._history = history

    def __iter__(self) -> Iterator[FrameColumns]:
        for chunk in super().__iter__():
            self._history.take(chunk)
            yield chunk


class ReplayReport:
    """Gathers what the page needs, then writes it. Raises ImucaldError before any work."""

    def __init__(self, loaded: LoadedConfig, options: argparse.Namespace) -> None:
        require_libraries()
        folder: Path = options.report
        if folder.exists() and not folder.is_dir():
            raise ImucaldError(f"{folder}: cannot be written: Not a directory")
        if not folder.parent.is_dir():
            raise ImucaldError(f"{folder}: cannot be written: no directory {folder.parent}")
        self.history = DriveHistory(loaded)
        self._options = options

    def snapshot(self, snapshot: Snapshot) -> None:
        """Take a snapshot of the estimate."""
        self.history.snapshot(snapshot)

    def reader(self, *arguments: Any) -> LogReader:
        """Return a reader that the history watches; arguments as for `LogReader`."""
        return _WatchedReader(self.history, *arguments)

    def sink(self, engine: Engine, other: Sink | None) -> Sink:
        """Return what takes the frames that are given out, and hands them on."""
        ours = self.history.sink(engine)

        def both(frames: FrameColumns) -> None:
            ours(frames)
            if other is not None:
                other(frames)

        return both

    def write(self, result: Mapping[str, Any], problems: Sequence[str]) -> None:
        """Write the page. Raises ImucaldError where that cannot be."""
        options = self._options
        about = About(
            logs=["/".join(Path(log).parts[-2:]) for log in options.logs],
            config=options.config.name,
            model="",
            made=f"{time.strftime('%Y-%m-%d %H:%M')}, imucald {__version__}",
        )
        page = replay_page(self.history, result, problems, about)
        try:
            options.report.mkdir(exist_ok=True)
        except OSError as error:
            reason = error.strerror or error
            raise ImucaldError(f"{options.report}: cannot be written: {reason}") from None
        write_text(options.report / PAGE, page)
        if not options.quiet:
            print(f"imucald: written: {options.report / PAGE}", file=sys.stderr)
