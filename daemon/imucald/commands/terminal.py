"""Text output: progress and tables. Progress is written to stderr, and only on a terminal."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import IO, TYPE_CHECKING, Any, TextIO, cast

from imucald.core.text import clock, counted, made_safe, reached_states, stream_behind

if TYPE_CHECKING:
    from rich.console import Console

Progress = Callable[[int, int | None], None]


MOST_EVENTS = 10
"""Largest number of event lines after a replay. With this number, events and mount fit on one
screen."""
PIPED_WIDTH = 2000
"""Width of the output [columns] without a terminal, so that each row is one line."""


class _LinesWithoutPadding(io.TextIOBase):
    """Text stream that passes lines to another stream and removes trailing blanks of table
    columns."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._line = ""

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """The encoding of the underlying stream."""
        return self._stream.encoding

    def write(self, text: str) -> int:
        """Pass the complete lines to the other stream."""
        *lines, self._line = (self._line + text).split("\n")
        self._stream.writelines(f"{line.rstrip(' ')}\n" for line in lines)
        return len(text)

    def flush(self) -> None:
        """Pass the remaining text to the other stream."""
        self._stream.write(self._line)
        self._line = ""
        self._stream.flush()


def screen_console(**given: Any) -> Console:
    """Make a console of rich. Control codes in texts are removed. The control codes of rich itself
    are kept."""
    from rich.console import Console
    from rich.segment import Segment

    class ScreenConsole(Console):
        @property
        def file(self) -> IO[str]:
            found: IO[str] = stream_behind(super().file)
            return found

        @file.setter
        def file(self, new_file: IO[str]) -> None:
            self._file = new_file

        def render(self, *given: Any, **named: Any) -> Iterator[Segment]:
            for part in super().render(*given, **named):
                text, style, control = part
                yield part if control else Segment(made_safe(text), style)

        def on_broken_pipe(self) -> None:
            raise BrokenPipeError

    return ScreenConsole(**given)


def plain_console() -> Console:
    """Make a console for tables on standard output.

    Names from databases are not interpreted as markup, and a closed pipe is not an error. Without a
    terminal, each row is one line, for `grep` and `awk`.
    """
    if sys.stdout.isatty() or "COLUMNS" in os.environ:
        return screen_console(highlight=False, markup=False)
    file = cast("IO[str]", _LinesWithoutPadding(stream_behind(sys.stdout)))
    return screen_console(highlight=False, markup=False, width=PIPED_WIDTH, file=file)


@contextmanager
def _bar(
    text: str, total: float | None, quiet: bool, *columns: str
) -> Iterator[Callable[..., None] | None]:
    """Show a bar with these columns of rich while the body runs, on stderr. Yields a callback for
    the done part, or None without a terminal."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from rich import progress

    shown = [progress.TextColumn("{task.description}", markup=False), progress.BarColumn()]
    shown += [getattr(progress, name)() for name in columns]
    with progress.Progress(*shown, console=screen_console(stderr=True), transient=True) as bar:
        task = bar.add_task(text, total=total)
        yield lambda done, **more: bar.update(task, completed=done, **more)


@contextmanager
def progress_bar(text: str, quiet: bool = False) -> Iterator[Progress | None]:
    """Show a bar while the body runs. Yields a callback for (done, total) bytes, or None."""
    with _bar(text, None, quiet, "DownloadColumn", "TimeRemainingColumn") as update:
        yield update and (lambda done, total: update(done, total=total))


@contextmanager
def share_bar(text: str, quiet: bool = False) -> Iterator[Callable[[float, str], None]]:
    """Show a bar and the current step. Yields a callback for the share done (0 to 1) and the text
    of the step."""
    with _bar(text, 1.0, quiet, "TaskProgressColumn", "TimeElapsedColumn") as update:
        yield lambda share, doing: update and update(share, description=doing or text)


@contextmanager
def countdown(text: str, seconds: float) -> Iterator[Callable[[float], None]]:
    """Show the elapsed part of a known time. Yields a callback for the elapsed seconds."""
    with _bar(text, seconds, False, "TimeRemainingColumn") as update:
        yield lambda passed: update and update(passed)


def plain_where_needed() -> None:
    """Make standard output replace characters that its encoding lacks with '?'."""
    stdout = stream_behind(sys.stdout)
    if isinstance(stdout, io.TextIOWrapper):
        stdout.reconfigure(errors="replace")


def print_summary(result: Mapping[str, Any], causes: Sequence[str] = ()) -> None:
    """Print the result of a replay as tables. causes: likely causes of contradictions."""
    from rich.text import Text

    from imucald.commands.status_view import mount_parts
    from imucald.mount.mount_words import left_out_words

    plain_where_needed()
    console = plain_console()
    reached = ", ".join(reached_states(result))
    since = f" ({reached})" if reached else ""
    console.print(Text.assemble("state: ", (result["state"], "bold"), since))
    for text in causes:
        console.print(f"likely cause (imucald check): {text}", style="bold red")
    for part in mount_parts(result, is_checked=bool(causes)):
        console.print(part)
    frames = result["frames"]
    signals = ", ".join(
        f"{name} {row['rate_hz'] or 0:.4g}/s" for name, row in result["signals"].items()
    )
    console.print(
        f"{counted(frames['read'], 'frame')} read, {frames['used']} used, "
        f"{result['duration_s']:.1f} s"
    )
    console.print(f"signals: {signals or 'none'}")
    if frames["rejected"]:
        rejected = ", ".join(f"{reason} {n}" for reason, n in frames["rejected"].items())
        console.print(f"rejected: {rejected}")
    if left_out := left_out_words(result.get("details", {})):
        console.print(f"not used for the mount, of {result['duration_s']:.0f} s: {left_out}")
    for text in _noticed(result):
        console.print(text, style="bold red")
    for text in _beside(result):
        console.print(text)


def print_drives(rows: Sequence[Mapping[str, Any]], notes: Sequence[str]) -> None:
    """Print several drives, one row each, and notes on inconsistencies between them."""
    from rich.table import Table

    from imucald.mount.estimate import ANGLES
    from imucald.mount.mount_words import CONVENTION, angle_text

    plain_where_needed()
    console = plain_console()
    table = Table(box=None, pad_edge=False)
    table.add_column("drive", overflow="fold")
    for name in ("s", "state", *ANGLES):
        table.add_column(name, justify="left" if name == "state" else "right")
    for row in rows:
        angles = [angle_text(row[f"{angle}_deg"], row[f"std_{angle}_deg"]) for angle in ANGLES]
        table.add_row(row["log"], f"{row['duration_s']:.0f}", row["state"], *angles)
    console.print(table)
    console.print(CONVENTION)
    for note in notes:
        console.print(note)


def _noticed(result: Mapping[str, Any]) -> Iterator[str]:
    from imucald.runtime.drive_events import in_order, reported_events

    events = in_order(reported_events(result))
    for event in events[:MOST_EVENTS]:
        yield f"at {clock(event.t)}  {event.text}"
    if len(events) > MOST_EVENTS:
        yield f"and {len(events) - MOST_EVENTS} more events: --report and --json show all"


def _beside(result: Mapping[str, Any]) -> Iterator[str]:
    attitude = result.get("attitude")
    if attitude is not None:
        angles = ", ".join(
            f"{name} {_number(attitude.get(f'{name}_deg'), '.2f', ' deg')}"
            for name in ("roll", "pitch", "heading")
        )
        grade = _number(attitude.get("grade_percent"), ".1f", " %")
        yield f"attitude at the end: {angles}, grade {grade} ({attitude['state']})"
    travel = result.get("travel_direction")
    if travel is not None:
        heading = _number(travel["heading_deg"], ".0f", " deg")
        opposite = " or opposite" if travel["ambiguous"] else ""
        steps = counted(travel["steps"], "step")
        yield f"travel direction: {steps}, the last towards {heading}{opposite}"


def _number(value: float | None, form: str, unit: str) -> str:
    return "-" if value is None else f"{value:{form}}{unit}"
