"""The pages of option `--report`. The folder is checked before the replay; it is created and filled
after the replay."""

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
from imucald.mount.estimate import ANGLES
from imucald.mount.mount_words import CONVENTION, angle_text
from imucald.report.drive_history import DriveHistory
from imucald.report.page import About, environment, require_libraries
from imucald.report.replay_page import replay_page

PAGE = "index.html"


def check_report_folder(folder: Path) -> None:
    """Raise ImucaldError if a page cannot be made or cannot be written to the folder."""
    require_libraries()
    if folder.exists() and not folder.is_dir():
        raise ImucaldError(f"{folder}: cannot be written: Not a directory")


def make_folder(folder: Path) -> None:
    """Make a folder if it does not exist. Raises ImucaldError if the folder cannot be made."""
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise ImucaldError(f"{folder}: cannot be written: {error.strerror or error}") from None


def about_now(logs: Sequence[str], config: Path, model: str) -> About:
    """Return the data of a page's footer; model: text about the model file, "" without one."""
    return About(
        logs=["/".join(Path(log).parts[-2:]) for log in logs],
        config=config.name,
        model=model,
        made=f"{time.strftime('%Y-%m-%d %H:%M')}, imucald {__version__}",
    )


def write_page(folder: Path, page: str) -> Path:
    """Write the page into the folder, and return the path of the page. Raises ImucaldError if the
    page cannot be written."""
    make_folder(folder)
    write_text(folder / PAGE, page)
    return folder / PAGE


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
        """Write the page. causes: likely causes of contradictions. Raises ImucaldError if that
        fails."""
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
