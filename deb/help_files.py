"""Man page and shell completion, made from the command line's own parser.

    python deb/help_files.py --out DIR      # DIR/share/man/man1/imucald.1 and the completions

Nothing here is written by hand: a new option is in the page and in the completion with the next
build. The .deb has them; after `pip install` put them below ~/.local or /usr/local.
"""

from __future__ import annotations

import argparse
import gzip
import os
from collections.abc import Iterator
from pathlib import Path
from unittest import mock

import shtab
from argparse_manpage.manpage import Manpage

from imucald import __version__
from imucald.cli import build_parser

SUMMARY = "find how an inertial sensor sits in a vehicle, and correct its signals on CAN"
EXIT_STATUS = """0 done; 1 an error, which the text on standard error explains; 2 wrong usage;
78 a wrong configuration of \\fBrun\\fR; 130 Ctrl\\-C."""
FILES = """.TP
\\fI/etc/imucald/can0.yaml\\fR
configuration of the service imucald@can0
.TP
\\fI/var/lib/imucald/can0\\fR
saved state
.TP
\\fI/run/imucald/can0/status.sock\\fR
status socket"""
FILE_METAVARS = ("FILE", "FILE.log", "FILE.svg", "LOG", "PATH")
FOLDER_METAVARS = ("DIR",)
COMPLETIONS = {
    "bash": "share/bash-completion/completions/imucald",
    "zsh": "share/zsh/vendor-completions/_imucald",
    "fish": "share/fish/vendor_completions.d/imucald.fish",
}
MAN_PAGE = "share/man/man1/imucald.1.gz"


def man_page() -> str:
    """The page imucald(1), as roff."""
    data = {
        "description": SUMMARY,
        "project_name": "imucald",
        "version": __version__,
        "manual_title": "User commands",
        "manual_section": 1,
    }
    parser = build_parser()
    parser.epilog = None  # it leads to --help, of which this page is made
    with mock.patch.dict(os.environ, COLUMNS="10000"):  # man folds the lines
        page = str(Manpage(parser, _data=data))
    parts = [page, ".SH NOTES", *notes(parser), ".SH EXIT STATUS", EXIT_STATUS, ".SH FILES", FILES]
    return "\n".join(parts) + "\n"


def notes(parser: argparse.ArgumentParser) -> Iterator[str]:
    """What stands below the options of each command's help: exit status, examples."""
    for action in parser._actions:
        if not isinstance(action, argparse._SubParsersAction):
            continue
        for name, sub in action.choices.items():
            if sub.epilog:
                yield f".SS imucald {name}"
                yield from (roff(part) for part in sub.epilog.split("\n\n"))


def roff(paragraph: str) -> str:
    """A paragraph as roff; one that begins with a blank (examples) keeps its lines."""
    text = paragraph.replace("\\", "\\e").replace("-", "\\-")
    lines = [f"\\&{line}" for line in text.splitlines()]
    return "\n".join([".nf", *lines, ".fi"] if paragraph.startswith(" ") else [*lines, ".PP"])


def completion(shell: str) -> str:
    """The completion of commands, options and their files for one shell."""
    parser = build_parser()
    for action in actions_of(parser):
        if action.metavar in FILE_METAVARS:
            action.complete = shtab.FILE  # type: ignore[attr-defined]
        elif action.metavar in FOLDER_METAVARS:
            action.complete = shtab.DIRECTORY  # type: ignore[attr-defined]
    return str(shtab.complete(parser, shell))


def actions_of(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """All arguments and options, those of commands included."""
    for action in parser._actions:
        yield action
        if isinstance(action, argparse._SubParsersAction):
            for inner in action.choices.values():
                yield from actions_of(inner)


def write(prefix: Path) -> list[Path]:
    """Write all of them below a folder, such as /usr; return their paths."""
    contents = {place: completion(shell).encode() for shell, place in COMPLETIONS.items()}
    contents[MAN_PAGE] = gzip.compress(man_page().encode(), mtime=0)
    for place, content in contents.items():
        (prefix / place).parent.mkdir(parents=True, exist_ok=True)
        (prefix / place).write_bytes(content)
    return [prefix / place for place in contents]


if __name__ == "__main__":
    options = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    options.add_argument("--out", type=Path, required=True, metavar="DIR")
    print(*write(options.parse_args().out), sep="\n")
