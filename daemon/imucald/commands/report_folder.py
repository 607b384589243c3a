"""The folder of option `--report`. The folder is checked before the replay; it is created and
filled after the replay."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from imucald import __version__
from imucald.commands.files import write_text
from imucald.core.errors import ImucaldError
from imucald.report.page import About, require_libraries

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
