"""The files that commands read and write. Mistakes are reported before the work starts."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from imucald.core.errors import ImucaldError, LogError

STANDARD = "-"
"""The name for standard input or output."""

Name = Path | str


def fill_standard_files() -> None:
    """Open /dev/null if standard input, output or error is closed.

    Otherwise, the next opened file would get the file descriptor of the closed stream. Messages of
    libraries would then be written to this file, for example to a bus or to the saved state.
    """
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(number)


def check_files(inputs: Iterable[Name], outputs: Sequence[Name | None]) -> None:
    """Raise ImucaldError if an input is missing, or an output cannot be written or is an input.

    No file is opened, because an input may be a pipe. An output keeps its content if a later step
    fails.
    """
    read = [Path(name) for name in inputs if str(name) != STANDARD]
    for path in read:
        try:
            path.stat()
        except OSError as error:
            raise LogError(f"{path}: cannot be opened: {error.strerror or error}") from None
    wanted = [str(name) for name in outputs if name is not None]
    if wanted.count(STANDARD) > 1:
        raise ImucaldError(
            "'-' (standard output) is given twice: give a file for one of the outputs"
        )
    written: list[Path] = []
    for path in (Path(name) for name in wanted if name != STANDARD):
        _check_output(path)
        for other in (*read, *written):
            if path.resolve() == other.resolve() or (path.exists() and _same(path, other)):
                raise ImucaldError(
                    f"{path}: writing it would overwrite {other}; choose another name"
                )
        written.append(path)


def _same(path: Path, other: Path) -> bool:
    return other.exists() and path.is_file() and path.samefile(other)


def _check_output(path: Path) -> None:
    reason = ""
    if path.is_dir():
        reason = "Is a directory"
    elif not path.parent.is_dir():
        reason = f"no directory {path.parent}"
    elif not os.access(path if path.exists() else path.parent, os.W_OK):
        reason = "Permission denied"
    if reason:
        raise ImucaldError(f"{path}: cannot be written: {reason}")


def with_origin(svg: str, command: str) -> str:
    """Return the picture with `command`, the command line that draws it, in its metadata."""
    from html import escape  # only some commands draw

    head, opening, rest = svg.partition("<svg")
    tag, end, body = rest.partition(">")
    return f"{head}{opening}{tag}{end}\n<metadata>{escape(command)}</metadata>{body}"


def write_text(name: Name, text: str) -> None:
    """Write UTF-8 text to a file ('-': standard output). Raises ImucaldError if the file cannot be
    written."""
    if str(name) == STANDARD:
        sys.stdout.write(text)
        return
    try:
        Path(name).write_text(text, encoding="utf-8")
    except OSError as error:
        raise ImucaldError(f"{name}: cannot be written: {error.strerror or error}") from None


def write_yaml(name: Name, text: str, schema: str) -> None:
    """Write a YAML file with a line for editors that names its schema, and the schema next to it.

    schema: name of the schema file, from `commands.schema`. For standard output, only the text is
    written. Raises ImucaldError if a file cannot be written.
    """
    from imucald.commands.schema import schema_text

    if str(name) == STANDARD:
        write_text(name, text)
        return
    write_text(name, f"# yaml-language-server: $schema={schema}\n{text}")
    write_text(Path(name).with_name(schema), schema_text(schema))


@contextmanager
def reported_when_cut(name: Name) -> Iterator[None]:
    """Context for writing a file. If it ends with an error or Ctrl-C, a text on stderr states that
    the file is incomplete. There is no text if the file was removed (because the disk was full).
    """
    try:
        yield
    except BaseException:
        if str(name) != STANDARD and Path(name).exists():
            print(f"imucald: {name} is not complete", file=sys.stderr)
        raise
