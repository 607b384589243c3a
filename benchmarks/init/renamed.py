"""A database, and the configuration that is right, with names that tell nothing.

Messages become M1, M2, ..., signals S1, S2, ...; comments go, and of value tables only what means
'not available' stays.
"""

from __future__ import annotations

import re
from pathlib import Path

from imucald.inputs.settings_of_signals import is_no_value

_MESSAGE = re.compile(r"^(\s*BO_ \d+ )(\w+)(\s*:.*)$")
_SIGNAL = re.compile(r"^(\s*SG_ )(\w+)(.*)$")
_TABLE = re.compile(r'(\d+) "([^"]*)"')


def renamed(database: Path, config: Path, folder: Path) -> tuple[Path, Path, dict[str, str]]:
    """Write both anew; returns their paths, and the new ``MESSAGE.SIGNAL`` by the old."""
    folder.mkdir(parents=True, exist_ok=True)
    paths: dict[str, str] = {}
    messages: dict[str, str] = {}
    signals: dict[str, str] = {}
    lines, message = [], ""
    for line in database.read_text().splitlines():
        if match := _MESSAGE.match(line):
            message = match[2]
            messages[message] = f"M{len(messages) + 1}"
            lines.append(f"{match[1]}{messages[message]}{match[3]}")
        elif match := _SIGNAL.match(line):
            name = f"S{len(paths) + 1}"
            paths[f"{message}.{match[2]}"] = f"{messages[message]}.{name}"
            signals[match[2]] = name
            lines.append(f"{match[1]}{name}{match[3]}")
        elif line.startswith("VAL_ "):
            _, number, name, *_ = line.split()
            kept = [f'{n} "SNA"' for n, text in _TABLE.findall(line) if is_no_value(text)]
            lines += [f"VAL_ {number} {signals[name]} {' '.join(kept)} ;"] if kept else []
        elif not line.startswith("CM_"):
            lines.append(line)
    new_database, new_config = folder / "bus.dbc", folder / "truth.yaml"
    new_database.write_text("\n".join(lines) + "\n")
    text = config.read_text()
    text = re.sub(r'(path|database)("?): ("?)[^\s{},"]*\.dbc', r"\1\2: \3bus.dbc", text)
    for old, new in sorted(paths.items(), key=lambda item: -len(item[0])):
        text = re.sub(rf"(?<![\w.]){re.escape(old)}(?![\w.])", new, text)
    head, section, tail = text.partition("\nmessages:")
    for old, new in messages.items():
        tail = re.sub(rf"(?<!\w){old}:", f"{new}:", tail)
    for old, new in signals.items():
        tail = re.sub(rf"signal: {old}(?!\w)", f"signal: {new}", tail)
    new_config.write_text(head + section + tail)
    return new_database, new_config, paths
