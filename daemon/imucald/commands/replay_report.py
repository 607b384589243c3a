"""`imucald replay --report DIR`: make the page about a drive during the replay."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from imucald.commands.report_folder import about_now, check_report_folder, write_page
from imucald.core.errors import ImucaldError
from imucald.mount.estimate import ANGLES
from imucald.mount.mount_words import CONVENTION, angle_text
from imucald.report.drive_history import DriveHistory
from imucald.report.page import environment
from imucald.report.replay_page import replay_page


class ReplayReport:
    """Collects the data of the page during a replay, then writes the page. Raises ImucaldError
    before the replay if the page cannot be written."""

    def __init__(
        self,
        options: argparse.Namespace,
        logs: Sequence[str],
        folder: Path,
    ) -> None:
        check_report_folder(folder)
        if not folder.parent.is_dir():
            raise ImucaldError(f"{folder}: cannot be written: no directory {folder.parent}")
        self.history = DriveHistory()
        self._options, self._logs, self._folder = options, logs, folder

    def write(
        self, result: Mapping[str, Any], problems: Sequence[str], causes: Sequence[str]
    ) -> None:
        """Write the page. causes: see `replay_causes`. Raises ImucaldError if the page cannot be
        written."""
        options = self._options
        about = about_now(self._logs, options.config, model="")
        file = write_page(self._folder, replay_page(self.history, result, problems, about, causes))
        if not options.quiet:
            print(f"imucald: written: {file}", file=sys.stderr)


def write_index(
    folder: Path,
    drives: Sequence[tuple[str, Mapping[str, Any]]],
    notes: Sequence[str],
    agreements: Sequence[str],
) -> Path:
    """Write an index page with a row and a link for each drive; return its path.

    drives: for each drive, the name of its folder in `folder` and its row of `DriveSet.rows`.
    notes, agreements: see `DriveSet`. Raises ImucaldError if the page cannot be written.
    """
    rows = [
        (name, row, [angle_text(row[f"{a}_deg"], row[f"std_{a}_deg"]) for a in ANGLES])
        for name, row in drives
    ]
    page = environment().get_template("drives.html")
    texts = {"notes": notes, "agreements": agreements, "convention": CONVENTION}
    return write_page(folder, page.render(rows=rows, **texts))
