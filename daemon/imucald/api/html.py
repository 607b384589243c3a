"""HTML of results for notebooks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

from imucald.api.mount import MountResult
from imucald.core.text import when_reached
from imucald.mount.mount_words import CONVENTION, angle_text


def html_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return an HTML table; every text is escaped."""
    head = "".join(f"<th>{escape(text)}</th>" for text in heads)
    lines = ("".join(f"<td>{escape(text)}</td>" for text in row) for row in rows)
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def drive_html(
    logs: Sequence[str],
    mount: MountResult | None,
    summary: Mapping[str, Any],
    tables: Sequence[str],
    notes: Sequence[str] = (),
) -> str:
    """Return the HTML of a drive: its state, the three angles, its tables, and notes."""
    usable = summary["first_usable_s"]
    since = "never usable" if usable is None else when_reached("usable", usable)
    title = f"{', '.join(logs)}: {summary['state']}, {since}, {summary['duration_s']:.1f} s"
    angles: list[tuple[str, str, str]] = []
    for i, angle in enumerate(("roll", "pitch", "yaw")):
        value = None if mount is None else float(getattr(mount, f"{angle}_deg"))
        std = None if mount is None else mount.angle_std_deg[i]
        angles.append((angle, angle_text(value, std), summary["waiting_for"].get(angle, "")))
    found = html_table(("angle", CONVENTION, "waiting for"), angles)
    lines = [f"tables: {', '.join(tables)}", *(f"note: {note}" for note in notes)]
    return f"<p><b>{escape(title)}</b></p>{found}" + "".join(f"<p>{escape(x)}</p>" for x in lines)
