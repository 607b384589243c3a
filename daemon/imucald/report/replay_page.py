"""A replayed drive as a self-contained HTML page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from imucald.core.text import clock, duration, reached_states
from imucald.mount.estimate import ANGLES
from imucald.mount.mount_words import (
    CONVENTION,
    EVIDENCE_KINDS,
    VEHICLE_AXES,
    angle_cells,
    angles_line,
    half_width,
    is_trouble,
    judged_std,
    left_out_words,
    plus_minus,
    reasons,
    sent_words,
)
from imucald.report.drawing import STYLE, known_rotation, view_drawings
from imucald.report.drive_history import DriveHistory, DriveMotion
from imucald.report.page import About, environment, require_libraries
from imucald.runtime.drive_events import (
    STATE_WORDS,
    Event,
    in_order,
    reported_events,
    state_changes,
)

SNAPSHOT_S = 1.0
"""Period of snapshots in the history [s]."""


def replay_page(
    history: DriveHistory,
    result: Mapping[str, Any],
    problems: Sequence[str],
    about: About,
    causes: Sequence[str] = (),
) -> str:
    """Return the page as HTML text.

    result: as in docs/json.md. problems: bad lines of the log. causes: likely causes of the
    contradictions between signals.
    Raises ImucaldError if a library is missing.
    """
    require_libraries()
    from imucald.report import replay_plots as draw  # noqa: PLC0415 - loads matplotlib

    motion = history.motion()
    events = list(enumerate(drive_events(history, result), start=1))
    rows = np.isfinite(motion.corrected[:, 0])
    axes = (0, 1) if rows.any() else ()
    missing = list(reasons(result["waiting_for"]))
    evidence = {a: draw.evidence_picture(history, a) for a in ANGLES}
    return (
        environment()
        .get_template("replay.html")
        .render(
            about=about,
            duration=duration(result["duration_s"]),
            result=result,
            angles=angles_line(result["mount"]) or "The mount is not known",
            headline=_headline(result, history.lead),
            moves=[(clock(e.t), e.text) for _, e in events if e.kind == "moved"],
            lead=duration(history.lead) if history.lead >= SNAPSHOT_S else "",
            meaning=STATE_WORDS.get(result["state"], ""),
            waiting=[(names, text) for names, text in missing if not is_trouble(text)],
            troubles=[text for _, text in missing if is_trouble(text)],
            causes=causes,
            left_out=left_out_words(result["details"]),
            drawing_style=STYLE,
            views=view_drawings(known_rotation(result["mount"])),
            mount=[(angle, *angle_cells(result["mount"], angle)) for angle in ANGLES],
            turns=_axis_rows(result["mount"]),
            quaternion=_quaternion(result["mount"]),
            sent=sent_words(result.get("correction")),
            convention=CONVENTION,
            mount_picture=draw.mount_picture(history, events) if history.moments else "",
            events=[(number, clock(e.t), e.kind, e.text) for number, e in events],
            stretch=draw.stretch_picture(motion) if rows.any() else "",
            scatters=[draw.scatter_picture(motion, axis) for axis in (0, 1)] if rows.any() else [],
            fits=_fits(motion),
            maps=[draw.residual_map(motion, axis) for axis in axes],
            evidence={angle: svg for angle, svg in evidence.items() if svg},
            sources=_sources(result["details"]),
            arrivals=draw.arrivals_picture(history),
            gaps=[clock(t) for t in history.gaps],
            rejected=sorted(result["frames"]["rejected"].items(), key=lambda row: -row[1]),
            problems=problems[:20],
        )
    )


def drive_events(history: DriveHistory, result: Mapping[str, Any]) -> list[Event]:
    """Return the events of the drive, sorted by time."""
    states = ((m.t, m.estimate.state.name.lower(), m.estimate.waiting_for) for m in history.moments)
    changes = [_at_its_time(event, history, result) for event in state_changes(states)]
    return in_order([*changes, *reported_events(result, history.gaps)])


def _at_its_time(event: Event, history: DriveHistory, result: Mapping[str, Any]) -> Event:
    """Return the event with its exact time if it is the first *usable* or *fine*. The history
    contains this time only in whole seconds."""
    first = result.get(f"first_{event.text.partition(':')[0]}_s")
    came = None if first is None else first - history.lead
    if came is None or not event.t - SNAPSHOT_S <= came <= event.t:
        return event
    return replace(event, t=came)


def _headline(result: Mapping[str, Any], lead: float) -> str:
    reached = reached_states(result, lead)
    state = f"{result['state'][:1].upper()}{result['state'][1:]} at the end"
    return f"{state}: {', '.join(reached) or 'never usable'}"


def _axis_rows(mount: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return a row for each axis: the remaining uncertainty of the rotation about the axis (±), and
    its limits for the states."""
    rows: list[tuple[str, ...]] = []
    for axis, turn in zip("xyz", VEHICLE_AXES, strict=True):
        targets = mount.get("target_std_deg")
        goals = ("-", "-") if targets is None else (
            plus_minus(targets["usable"][axis]), plus_minus(targets["fine"][axis])
        )  # fmt: skip
        of_turn = plus_minus(judged_std(mount, axis))
        rows.append((turn, of_turn, *goals))
    return rows


def _quaternion(mount: Mapping[str, Any]) -> str:
    numbers = mount["quaternion_wxyz"]
    return "" if numbers is None else " ".join(f"{q:+.4f}" for q in numbers)


def _fits(motion: DriveMotion) -> list[dict[str, str]]:
    """Return rows about the agreement of raw and corrected forces with the vehicle's motion: slope,
    and rms of the difference."""
    found = []
    for axis, (way, what, truth) in enumerate(
        (("forward", "dv/dt", motion.dvdt), ("left", "speed times yaw rate", motion.turn))
    ):
        known = np.isfinite(truth) & np.isfinite(motion.corrected[:, axis])
        if known.sum() < 10 or float(np.std(truth[known])) == 0.0:
            continue
        row = {"way": way, "what": what}
        for name, values in (("raw", motion.raw), ("corrected", motion.corrected)):
            x, y = truth[known], values[known, axis]
            row[f"{name}_slope"] = _number(float(np.cov(x, y)[0, 1] / np.var(x, ddof=1)))
            row[f"{name}_rms"] = _number(float(np.sqrt(np.mean((y - x) ** 2))))
            row[f"{name}_mean"] = _number(float(np.mean(y - x)))
        found.append(row)
    return found


def _number(x: float) -> str:
    return f"{x:.2f}" if math.isfinite(x) else "-"


def _sources(details: Mapping[str, Any]) -> list[tuple[str, str, list[tuple[str, str]]]]:
    """Return for each source of evidence its share in each angle and the 95 % interval that it
    alone would give."""
    shares = details.get("evidence_share") or {}
    rows = []
    for name, std in (details.get("evidence_std_deg") or {}).items():
        parts = [
            (angle, f"{100.0 * of[name]:.0f}\N{NO-BREAK SPACE}%")
            for angle, of in shares.items()
            if of.get(name, 0.0) >= 0.005
        ]
        kind = EVIDENCE_KINDS.get(name.rpartition("_")[2], "")
        angle = name.rpartition("_")[0] if kind else name.replace("_", " ")
        alone = "says nothing yet" if half_width(std) is None else plus_minus(std)
        rows.append((f"{angle}, from {kind}" if kind else angle, alone, parts))
    return sorted(rows, key=lambda row: row[0].partition(",")[0])
