"""The picture of `imucald monitor` for terminals of any width: bars of the intervals, inputs,
events."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from imucald.commands.status_view import BAR, facts, headline, is_stale, mount_parts, wrong_now
from imucald.core.errors import LinkError
from imucald.mount.mount_words import left_out_words, progress_words
from imucald.runtime.drive_events import reported_events
from imucald.runtime.timebase import FORWARD_STEP
from imucald.service.asking import ask, content


@dataclass(frozen=True)
class LiveEvent:
    """An event. at: wall clock [s]. kind: moved, evidence, fault, sensor, alarm or log.

    text: readable description.
    """

    at: float
    kind: str
    text: str

    @property
    def clock(self) -> str:
        """Time of day."""
        return time.strftime("%H:%M:%S", time.localtime(self.at))


def live_events(
    status: Mapping[str, Any], now: float, logged: Sequence[Mapping[str, Any]]
) -> list[LiveEvent]:
    """Return the events, oldest first. now: wall clock of the status [s]. logged: the log, as
    `imucald events` shows it."""
    # stream time stops in a long silence; an older daemon does not state it
    stood = max(0.0, float(status.get("silent_s", 0.0)) - FORWARD_STEP)
    began = now - stood - float(status["duration_s"])
    found = [LiveEvent(e["at"], _kind(e), e["text"]) for e in logged]
    found += [LiveEvent(began + e.t, e.kind, e.text) for e in reported_events(status)]
    return sorted(found, key=lambda event: event.at)


def asked_events(path: Path) -> list[dict[str, Any]]:
    """Return the log of the daemon at a status socket; empty if the daemon does not answer."""
    try:
        found: list[dict[str, Any]] = content(path, "events", ask(path, "events"))["events"]
    except LinkError:
        return []
    return found


def _kind(logged: Mapping[str, Any]) -> str:
    return "alarm" if logged["level"] in ("error", "warning") else "log"


BESIDE = 120
"""Smallest width [columns] for inputs and events side by side."""
BESIDE_INPUTS = 66
CLOCK_WIDTH = 11
"""Width of the column of times with its gap [columns]."""
LEAST_EVENTS = 3
FACTS = ("now", "losses", "rejected", "process")
KIND_STYLES = {
    "alarm": "red",
    "fault": "red",
    "moved": "bold red",
}


def monitor_picture(
    status: Mapping[str, Any],
    events: Sequence[LiveEvent],
    console: Console,
    foot: Text,
    trouble: str = "",
) -> Group:
    """Return the picture for a terminal. The newest events fill the remaining height.

    trouble: the reason why the daemon does not answer. The picture then shows the last status.
    """
    width, height = console.size
    is_grey = is_stale(status, trouble)
    mount = list(mount_parts(status, BAR if width < BESIDE else 60, is_grey))
    top: list[RenderableType] = [headline(status, trouble), _padded(mount)]
    inputs: RenderableType = inputs_table(status, is_grey)
    wanted = [*FACTS, "not used"] if left_out_words(status["details"]) else [*FACTS]
    if trouble:  # the last status says nothing about the present
        wanted.remove("now")
    below: list[RenderableType] = [Padding(facts(status, wanted), (1, 0, 0, 0)), foot]
    if width >= BESIDE:
        least = _lines(console, inputs)
        left = height - _lines(console, *top, *below)
        while left < least and len(mount) > 1:
            mount.pop()  # the last part is the least useful
            top[1] = _padded(mount)
            left = height - _lines(console, *top, *below)
        rows = max(left, least)
        shown = _fitting(console, events, rows, width - BESIDE_INPUTS)
        grid = Table.grid(padding=(0, 4))
        grid.add_column(width=BESIDE_INPUTS - 4)
        grid.add_column(ratio=1)
        grid.add_row(inputs, events_table(shown))
        return Group(*top, grid, *below)
    left = height - _lines(console, *top, inputs, *below) - 1
    if left < LEAST_EVENTS:  # a low terminal: one line for inputs and one for problems
        wrong = "" if trouble else wrong_now(status)
        below = [*([Text(f"now     {wrong}", style="red")] if wrong else []), foot]
        inputs = Text(_short(status))
        missing = "" if is_grey else progress_words(status.get("progress"))
        progress = [Text(missing)] if missing else []
        while True:
            line = [] if any(isinstance(part, Table) for part in mount[1:]) else progress
            top = [headline(status, trouble), Group(*mount, *line)]
            left = height - _lines(console, *top, inputs, *below) - 1
            if left >= LEAST_EVENTS or len(mount) == 1:
                break
            mount.pop()  # the last part is the least useful
    shown = _fitting(console, events, left, width)
    return Group(*top, inputs, Padding(events_table(shown), (1, 0, 0, 0)), *below)


def _padded(mount: Sequence[RenderableType]) -> Padding:
    return Padding(Group(*mount), (1, 0))


def _lines(console: Console, *parts: RenderableType) -> int:
    return sum(len(console.render_lines(part)) for part in parts)


def _fitting(
    console: Console, events: Sequence[LiveEvent], rows: int, width: int
) -> list[LiveEvent]:
    """Return the newest events that fit `rows` rows. If not even one fits, it is cut to one row."""
    options = console.options.update(width=width)
    shown = list(events)[-rows:] if rows > 1 else []
    while shown and len(console.render_lines(events_table(shown), options)) > rows:
        if len(shown) == 1:
            text = Text(shown[0].text)
            text.truncate(max(width - CLOCK_WIDTH, 1), overflow="ellipsis")
            return [replace(shown[0], text=text.plain)]
        del shown[0]
    return shown


def _short(status: Mapping[str, Any]) -> str:
    rows = status["signals"].items()
    return "inputs  " + (", ".join(f"{c} {row['rate_hz'] or 0:.4g}/s" for c, row in rows) or "none")


def inputs_table(status: Mapping[str, Any], is_grey: bool = False) -> Table:
    """Make the table of inputs: rate, number of samples, health."""
    table = Table(box=None, pad_edge=False)
    table.add_column("input")
    table.add_column("rate", justify="right")
    table.add_column("samples", justify="right")
    table.add_column("health")
    for channel, row in status["signals"].items():
        words, style = input_health(status, channel, row["rate_hz"])
        style = "dim" if is_grey and style == "green" else style
        rate = "-" if row["rate_hz"] is None else f"{row['rate_hz']:.4g}/s"
        table.add_row(channel, rate, str(row["samples"]), Text(words, style=style))
    if not status["signals"]:
        table.add_row("nothing yet", "", "", "")
    return table


def input_health(status: Mapping[str, Any], channel: str, rate: float | None) -> tuple[str, str]:
    """Return the health of an input as text and as style."""
    faults = status["signal_health"]["sensors"].get(channel)
    if faults:
        words = ", ".join(
            f"{fault} ({', '.join(axes)})" if axes else fault for fault, axes in faults.items()
        )
        return words, "bold red"
    if not rate:
        return "silent", "red"
    return ("sound", "green") if faults is not None else ("received, not checked", "dim")


def events_table(events: Sequence[LiveEvent]) -> Table:
    """Make the table of events with their times of day."""
    table = Table(box=None, pad_edge=False)
    table.add_column("time", style="dim", no_wrap=True)
    table.add_column("event", overflow="fold")
    for event in events:
        table.add_row(event.clock, Text(event.text, style=KIND_STYLES.get(event.kind, "")))
    return table
