"""`imucald replay --report DIR`: the page about a drive, made beside the replay."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from imucald import __version__
from imucald.commands.files import write_text
from imucald.core.errors import ImucaldError
from imucald.report.drive_history import DriveHistory
from imucald.report.page import About, require_libraries
from imucald.report.replay_page import replay_page

PAGE = "index.html"


class ReplayReport:
    """Gathers what the page needs, then writes it. Raises ImucaldError before any work."""

    def __init__(
        self,
        options: argparse.Namespace,
        logs: Sequence[str],
        folder: Path,
    ) -> None:
        require_libraries()
        if folder.exists() and not folder.is_dir():
            raise ImucaldError(f"{folder}: cannot be written: Not a directory")
        if not folder.parent.is_dir():
            raise ImucaldError(f"{folder}: cannot be written: no directory {folder.parent}")
        self.history = DriveHistory()
        self._options, self._logs, self._folder = options, logs, folder

    def write(self, result: Mapping[str, Any], problems: Sequence[str]) -> None:
        """Write the page. Raises ImucaldError where that cannot be."""
        options = self._options
        about = About(
            logs=["/".join(Path(log).parts[-2:]) for log in self._logs],
            config=options.config.name,
            model="",
            made=f"{time.strftime('%Y-%m-%d %H:%M')}, imucald {__version__}",
        )
        page = replay_page(self.history, result, problems, about)
        try:
            self._folder.mkdir(exist_ok=True)
        except OSError as error:
            reason = error.strerror or error
            raise ImucaldError(f"{self._folder}: cannot be written: {reason}") from None
        write_text(self._folder / PAGE, page)
        if not options.quiet:
            print(f"imucald: written: {self._folder / PAGE}", file=sys.stderr)
