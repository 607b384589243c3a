"""The changes of an extended model file: keys with the values before and after the extension."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from imucald.diagnosis.result import Diagnosis
from imucald.model.model import VehicleModel

SAME = 1e-12
"""Numbers that differ by less than this count as equal, because the difference is a rounding
error."""
SHOWN_ITEMS = 8
"""For a list with more items (drop-outs), only its length is shown. The complete file contains all
items."""


@dataclass(frozen=True)
class Change:
    """One changed key of the model file. Values are JSON values."""

    key: str
    before: Any
    after: Any


def model_changes(before: VehicleModel, after: VehicleModel) -> list[Change]:
    """Return every key whose value differs, in the order of the file. A list counts as one value.
    Residuals of drives (`leaves`) are not listed, because they are not parameters.
    """
    old, new = (dict(_flat({**model.dump(), "leaves": {}})) for model in (before, after))
    return [
        Change(key, old.get(key), new.get(key))
        for key in dict.fromkeys((*old, *new))
        if not _is_same(old.get(key), new.get(key))
    ]


def shown_changes(diagnosis: Diagnosis) -> list[Change]:
    """Return the changes, without changed delays of signals that the drives do not contain. Such
    changes occur because a negative delay is avoided by increasing the delays of all signals.
    """
    present = diagnosis.channels
    return [
        change
        for change in model_changes(diagnosis.model_before, diagnosis.model_after)
        if present is None
        or not change.key.endswith(".delay_s")
        or change.key.partition(".")[0] in present
    ]


def is_of_cause(change: Change, diagnosis: Diagnosis) -> bool:
    """Return whether a found cause has this key. The other keys were estimated because nothing
    states them."""
    keys = (key for cause in diagnosis.causes for key in cause.in_file)
    return any(key == change.key or key.startswith(f"{change.key}.") for key in keys)


def _is_same(before: Any, after: Any) -> bool:
    if isinstance(before, float) and isinstance(after, float):
        return abs(before - after) < SAME or before == after
    if isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        return all(map(_is_same, before, after))
    return bool(before == after)


def _flat(data: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in data.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{path}{key}.")
        else:
            yield f"{path}{key}", value


def value_text(value: Any) -> str:
    """Return a value as YAML text: numbers with six digits; for long lists only the length."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list):
        if len(value) > SHOWN_ITEMS:
            return f"[{len(value)} entries]"
        return f"[{', '.join(value_text(item) for item in value)}]"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{k}: {value_text(v)}" for k, v in value.items()) + "}"
    return str(value)


def as_diff(changes: list[Change]) -> list[tuple[str, str]]:
    """Return the changes as lines of a YAML file: (' ', '-' or '+', text)."""
    lines: list[tuple[str, str]] = []
    open_sections: list[str] = []
    for change in changes:
        *sections, last = change.key.split(".")
        common = 0
        while sections[: common + 1] == open_sections[: common + 1] and common < len(sections):
            common += 1
        for depth in range(common, len(sections)):
            lines.append((" ", f"{'  ' * depth}{sections[depth]}:"))
        open_sections = sections
        indent = "  " * len(sections)
        lines.append(("-", f"{indent}{last}: {value_text(change.before)}"))
        lines.append(("+", f"{indent}{last}: {value_text(change.after)}"))
    return lines
