"""Show a daemon's status on a terminal, for `status` and `monitor`."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator, Mapping
from typing import Any

from rich.console import Console, Group
from rich.padding import Padding
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from imucald.core.errors import LinkError
from imucald.core.text import clock, counted, reached_states
from imucald.mount.estimate import ANGLES
from imucald.mount.hysteresis import BAD
from imucald.mount.mount_words import (
    ABOUT,
    EVIDENCE_KINDS,
    VEHICLE_AXES,
    angle_cells,
    angles_line,
    contradicted_words,
    driving_left,
    is_trouble,
    judged_std,
    left_out_words,
    percent,
    plus_minus,
    progress_words,
    reasons,
    sent_words,
    target_words,
)
from imucald.mount.states import HARD_ACCEL, HARD_TURN
from imucald.runtime.drive_events import STATE_WORDS
from imucald.runtime.flow import FlowKind, flow, is_starting, present_alarms
from imucald.service.asking import BusyError

BAR = 24
"""Width of a bar [columns]."""


TRY_CHECK = "run 'imucald check' on this bus or on a log: it names a wrong sign, axis or unit"
"""Text about a contradiction between signals. More driving does not remove the contradiction."""


def mount_parts(
    result: Mapping[str, Any], bar: int = BAR, is_stale: bool = False, is_checked: bool = False
) -> Iterator[Table | Text]:
    """Yield the parts of the view, the most useful part first: angles of the housing, orientation
    of the sensor, missing evidence, remaining driving, axes of corrected samples, an explanation of
    "±", and the remaining errors of corrected samples.

    result: as in docs/json.md, or a status (also of an older daemon). bar: width of bars [columns].
    is_stale: no corrected frames are sent now, so no target is shown as reached. is_checked: the
    result of `check` is shown too.
    """
    mount, progress = result["mount"], result.get("progress")
    yield _angles(result)
    for key, style in (("sits", ""), ("steep", "yellow"), ("mirrored", "yellow")):
        if mount.get(key):
            yield Text(mount[key], style=style)
    for names, text in reasons(result["waiting_for"]):
        if is_trouble(text):
            yield Text(f"trouble      {text}", style="bold red")
        elif not is_stale:  # driving does not help while nothing flows
            yield Text(f"waiting for  {names}: {text}", style="yellow")
    if result.get("standing_faults") and not is_checked:
        yield Text(f"next         {TRY_CHECK}", style="yellow")
    if progress is not None:
        yield _gates(progress, bar, is_stale)
    yield _axes(result, is_stale)
    yield Text(ABOUT, style="dim")
    if left := sent_words(result.get("correction")):
        yield Text(f"errors left in corrected frames: {left}")


def _gates(progress: Mapping[str, Any], bar: int, is_stale: bool) -> Table:
    """Make a bar for each missing condition. is_stale: no corrected frames are sent now, so nothing
    is shown as good and no time is stated."""
    unfinished, finished = ("dim", "dim") if is_stale else ("yellow", "green")
    table = Table(box=None, pad_edge=False)
    table.add_column(f"to {progress['goal']}")
    table.add_column("")
    table.add_column("", justify="right")
    table.add_column("")
    for gate in progress["gates"]:
        share = ProgressBar(
            1.0, gate["share"], bar, complete_style=unfinished, finished_style=finished
        )
        left = "" if is_stale else driving_left(gate["left_s"])
        table.add_row(gate["gate"], share, percent(gate["share"]), left)
    return table


def _angles(result: Mapping[str, Any]) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column("mount", min_width=6)
    table.add_column("angle", justify="right", min_width=8)
    table.add_column("± 95 %", justify="right", min_width=7)
    for angle in ANGLES:
        table.add_row(angle, *angle_cells(result["mount"], angle))
    return table


def _axes(result: Mapping[str, Any], is_stale: bool) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column("corrected", min_width=12)
    table.add_column("± 95 %", justify="right", min_width=7)
    table.add_column("target")
    for axis, turn in zip("xyz", VEHICLE_AXES, strict=True):
        words, is_reached = target_words(result, axis)
        text = Text(words, style="dim" if is_stale else "green" if is_reached else "")
        table.add_row(turn, plus_minus(judged_std(result["mount"], axis)), text)
    return table


STYLES = {
    "usable": "green",
    "fine": "bold green",
    "restored": "cyan",
    "suspect": "bold red",
    "recalibrating": "red",
}
DOUBTED = frozenset(state.name.lower() for state in BAD)
FLOW_STYLES = {
    FlowKind.SERVED: "bold green",
    FlowKind.STARTING: "yellow",
    FlowKind.NOT_YET: "yellow",
    FlowKind.SUSPECT: "bold red",
    FlowKind.FAULTY: "bold red",
    FlowKind.CONFLICT: "bold white on red",
    FlowKind.NONE: "bold white on red",
}
SILENT = frozenset({FlowKind.NONE, FlowKind.STARTING})
HARD = f"above {HARD_ACCEL:g} m/s²"
HARD_BENDS = f"above {HARD_TURN:g} m/s²"
EVIDENCE = {
    "launches_and_brakings": (f"launch or braking {HARD}", f"launches and brakings {HARD}"),
    "manoeuvres": ("manoeuvre", ""),
    "left_turns": (f"left turn {HARD_BENDS}", f"left turns {HARD_BENDS}"),
    "right_turns": (f"right turn {HARD_BENDS}", f"right turns {HARD_BENDS}"),
    "stops": ("stop", ""),
    "off_vertical": ("restart", "restarts"),
}
"""Names of the kinds of evidence, singular and plural. Only strong manoeuvres are counted, but
gentle driving is evidence too."""

PHASES = {
    "handing_over": "being replaced by the mount of this drive",
    "new": "replaced by the mount of this drive",
}
"""Texts for the phases of a restored or stated mount that are not clear by their names."""
SHARE_SHOWN = 0.05
_SILENT = frozenset({"accelerometer_missing", "gyroscope_missing"})
"""Alarms for sensors that send no samples."""


def short(status: Mapping[str, Any], with_angles: bool = True) -> str:
    """Return the status as one line: the frames that are sent now, the angles, the missing
    evidence."""
    now = flow(status)
    parts = [now.text, angles_line(status["mount"]) if with_angles else ""]
    if now.kind is not FlowKind.NONE:  # driving does not help while nothing flows
        parts += [f"waiting for {who}: {text}" for who, text in reasons(status["waiting_for"])][:1]
        parts.append(progress_words(status.get("progress")))
    return "; ".join(filter(None, parts))


def picture(status: Mapping[str, Any]) -> Group:
    """Return the complete status, for any width."""
    mount = Group(*mount_parts(status, is_stale=is_stale(status)))
    return Group(headline(status), Padding(mount, (1, 0)), facts(status))


def print_status(console: Console, status: Mapping[str, Any]) -> None:
    """Print the complete status. The first line is repeated at the end if it is not visible any
    more."""
    whole = picture(status)
    console.print(whole)
    if console.is_terminal and len(console.render_lines(whole)) >= console.height:
        console.print(_first_line(status))


def _first_line(status: Mapping[str, Any]) -> Text:
    now = flow(status)
    return Text(now.text, style=FLOW_STYLES[now.kind])


def headline(status: Mapping[str, Any], trouble: str = "") -> Text:
    """Return the first lines: whether corrected frames are sent now, the daemon, and the state of
    the mount.

    trouble: the reason why the daemon does not answer; status is then its last status. The state
    has its colour only while frames are sent, because a known mount is useless without frames.
    """
    link, state, text = status["link"], status["state"], Text()
    if trouble:
        text.append(f"NO ANSWER: {trouble}", style=FLOW_STYLES[FlowKind.NONE])
    else:
        text.append(_first_line(status))
    text.append("\nimucald ", style="bold")
    text.append(f"{status['version']} on {link['channel']}")
    is_grey = is_stale(status, trouble)
    up = "dim" if is_grey else "green"
    text.append(f" ({link['state']})", style=up if link["state"] == "up" else "bold red")
    text.append(f", {status['vehicle']}, up {clock(status['uptime_s'])}\nmount  ")
    text.append(state, style="dim" if is_grey else STYLES.get(state, "yellow"))
    if status.get("held"):
        text.append("   held: nothing is learnt", style="bold yellow")
    for reached in reached_states(status) if state != "restored" else ():
        text.append(f"   {reached}")
    return text


def is_stale(status: Mapping[str, Any], trouble: str = "") -> bool:
    """True if no corrected frames are sent now. In this case nothing may be shown as good. trouble:
    see `headline`."""
    return bool(trouble) or flow(status).kind in SILENT


def no_answer(error: Exception, last: float | None) -> str:
    """Return a text that states why a daemon does not answer. last: time of day of its last answer
    [s]."""
    if last is None:
        return str(error)
    words = "the daemon has ended"
    if isinstance(error, BusyError) or not isinstance(error, LinkError):
        words = "the daemon does not answer"
    return f"{words}; its last answer was at {time.strftime('%H:%M:%S', time.localtime(last))}"


def facts(status: Mapping[str, Any], wanted: Collection[str] = ()) -> Table:
    """Return a table with signals, evidence, frames, alarms, losses, saved state and process.

    wanted: the rows to show; all rows if empty.
    """
    grid = Table.grid(padding=(0, 2))
    grid.add_column(style="dim", no_wrap=True)
    grid.add_column(overflow="fold")
    for name, value in _rows(status).items():
        if not wanted or name in wanted:
            grid.add_row(name, value)
    return grid


def wrong_now(status: Mapping[str, Any]) -> str:
    """Return one line about present problems; "" if there are none."""
    return "; ".join([*present_alarms(status).values(), *_troubles(status)])


def _rows(status: Mapping[str, Any]) -> dict[str, str | Text]:
    link, frames, process = status["link"], status["frames"], status["process"]
    rates = [f"{c} {row['rate_hz']:.4g}/s" for c, row in status["signals"].items()]
    wrong = wrong_now(status)
    well = "starting: no samples yet" if is_starting(status) else ""
    rejected = [f"{reason} {n}" for reason, n in frames["rejected"].items()]
    rss = "?" if process["rss_bytes"] is None else f"{process['rss_bytes'] / 2**20:.0f} MiB"
    share = 100.0 * process["cpu_s"] / max(status["uptime_s"], 1.0)
    return {
        "signals": ", ".join(rates) or "none yet",
        "evidence": _evidence(status["details"]),
        "weights": _weights(status["details"]),
        "not used": left_out_words(status["details"]) or "nothing so far",
        "frames": f"{frames['used']} used, {status['frames_given_out']} sent",
        "now": Text(wrong or well or "nothing wrong", style="red" if wrong else ""),
        "sensors": _sensors(status),
        "losses": f"{link['lost']} lost, {link.get('late', 0)} late, "
        f"{sum(link['send_errors'].values())} not sent, "
        f"{link['conflicts']} in conflict, down {counted(link['went_down'], 'time')}, "
        f"reopened {counted(link['reopened'], 'time')}" + _not_understood(link),
        "rejected": ", ".join(rejected) or "none",
        "saved": _saved(status["saved_state"]),
        "process": f"pid {process['pid']}, {rss}, {share:.1f} % of a core since the start",
    }


def _not_understood(link: Mapping[str, Any]) -> str:
    """Return a text about frames that python-can could not interpret, if there are any."""
    count = link.get("rejected", 0)  # an older daemon does not count them
    return f", {count} not understood" if count else ""


def _troubles(status: Mapping[str, Any]) -> list[str]:
    """Return texts about problems of mount and signals. If there is no such text and the mount is
    suspect, the result is a text about the state."""
    found = [text for _, text in reasons(status["waiting_for"]) if is_trouble(text)]
    restored = status["details"].get("restored", {})
    if not found and restored.get("phase") == "doubted":
        if wrong := restored.get("contradicted"):
            found.append(contradicted_words(wrong["turned_deg"], restored["given"]))
        elif restored.get("doubt"):
            found.append(f"the mount was suspect when it was saved: {restored['doubt']}")
    if not found and status["state"] in DOUBTED:
        found = [f"the mount is {status['state']}: {STATE_WORDS[status['state']]}"]
    return found


def _sensors(status: Mapping[str, Any]) -> Text:
    health = status["signal_health"]
    absent = [words for name, words in present_alarms(status).items() if name in _SILENT]
    if is_starting(status):
        return Text("no samples received yet")
    faulty = absent + [
        f"{channel} {fault}" + (f" ({', '.join(axes)})" if axes else "")
        for channel, faults in health["sensors"].items()
        for fault, axes in faults.items()
    ]
    count = len(health["events"])
    before = f"; {counted(count, 'fault')} so far" if count else ""
    return Text((", ".join(faulty) or "all sound") + before, style="bold red" if faulty else "")


def _evidence(details: Mapping[str, Any]) -> str:
    parts = [counted(details[key], *nouns) for key, nouns in EVIDENCE.items() if key in details]
    if "restored" in details:
        restored = details["restored"]
        whose = "stated mount" if restored.get("given") else "mount of an earlier drive"
        turned = restored.get("turned_deg")
        off = "" if turned is None else f", {turned:.0f} deg from the mount of this drive"
        phase = PHASES.get(restored["phase"], restored["phase"])
        parts.append(f"{whose}: {phase}{off}")
    if details.get("not_checked"):
        parts.append(f"not checked: {'; '.join(details['not_checked'])}")
    return ", ".join(parts) or "none yet"


def _weights(details: Mapping[str, Any]) -> str:
    parts = []
    for angle, shares in details.get("evidence_share", {}).items():
        sums: dict[str, float] = {}
        for name, share in shares.items():
            source = name.rpartition("_")[2]
            source = EVIDENCE_KINDS.get(source, name)
            sums[source] = sums.get(source, 0.0) + share
        named = [
            f"{source} {100 * share:.0f} %"
            for source, share in sorted(sums.items(), key=lambda item: -item[1])
            if share >= SHARE_SHOWN
        ]
        parts.append(f"{angle}: {', '.join(named)}")
    return "; ".join(parts) or "-"


def _saved(saved: Mapping[str, Any]) -> Text:
    if saved["folder"] is None:
        return Text("nowhere (no --state-dir)")
    what = f"generation {saved['generation']}" if saved["generation"] else "nothing"
    text = Text(f"{what} in {saved['folder']}")
    for problem in saved["problems"]:
        text.append(f"\n{problem}", style="yellow")
    if saved["last_error"]:
        text.append(f"\ncannot be saved: {saved['last_error']}", style="bold red")
    if saved.get("to_be_forgotten"):  # an older daemon does not state it
        text.append("\na reset is not saved yet: a restart would undo it", style="bold red")
    return text
