"""Databases of other projects: what loads, what is left out, what is decoded as by cantools.

`python -m benchmarks.databases FOLDER ...` reads every database under the folders, decodes random
payloads of each message here and by cantools, and prints a table.
"""

from __future__ import annotations

import argparse
import logging
import math
import random
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cantools

from imucald.can.dbc.database import FORMATS, Database, decoded, load_database
from imucald.can.dbc.decode import compile_decode
from imucald.can.dbc.message import Message
from imucald.core.errors import DatabaseError

PAYLOADS = 3
"""Of each message."""
COLUMNS = (
    "files", "loaded here", "loaded by cantools", "left out", "choices named", "messages",
    "signals", "equal", "different", "not decodable",
)  # fmt: skip


def main() -> None:
    """Print the table, and before it every refusal and every difference."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--quiet", action="store_true", help="the table alone")
    options = parser.parse_args()
    logging.disable(logging.CRITICAL)
    rows = []
    for folder in options.folders:
        counts: Counter[str] = Counter()
        for path in sorted(p for p in folder.rglob("*") if p.suffix.lower()[1:] in FORMATS):
            for line in _compared(path, counts):
                if not options.quiet:
                    print(f"{path.relative_to(folder)}: {line}")
        rows.append((folder.name, counts))
    print("| folder | " + " | ".join(COLUMNS) + " |")
    print("|---" * (len(COLUMNS) + 1) + "|")
    for name, counts in rows:
        print(f"| {name} | " + " | ".join(str(counts[column]) for column in COLUMNS) + " |")


def _compared(path: Path, counts: Counter[str]) -> Iterator[str]:
    """Count what a file comes to; a line for what is refused, left out or different."""
    counts["files"] += 1
    theirs: Any = None
    try:
        text = decoded(path.read_bytes())  # by itself it takes all text as cp1252
        theirs = cantools.database.load_string(text, path.suffix.lower()[1:], strict=False)
        counts["loaded by cantools"] += 1
    except Exception:  # whatever it raises: it does not load
        theirs = None
    try:
        ours = load_database(path)
    except DatabaseError as error:
        yield f"refused: {error}"
        return
    counts["loaded here"] += 1
    unread = [m for m in ours.messages.values() if m.unsupported.startswith("left out")]
    counts["left out"] += len(unread)
    counts["choices named"] += sum(len(m.left_out) for m in ours.messages.values())
    yield from ours.left_out
    for message in getattr(theirs, "messages", ()):
        yield from _message(ours, message, counts)


def _message(ours: Database, theirs: Any, counts: Counter[str]) -> Iterator[str]:
    message = ours.messages.get(theirs.name)
    if message is None or message.unsupported or message.can_id & 0x1FFF_FFFF != theirs.frame_id:
        return
    counts["messages"] += 1
    rng = random.Random(theirs.name)
    payloads = [rng.randbytes(message.length) for _ in range(PAYLOADS)]
    expected = [_decoded(theirs, data) for data in payloads]
    for name in message.signals:
        counts["signals"] += 1
        try:
            plan = compile_decode(message, [name])
        except DatabaseError:
            counts["not decodable"] += 1
            continue
        for data, values in zip(payloads, expected, strict=True):
            if values is None:
                continue
            here, there = plan.decode(data)[0], values.get(name)
            same = here == _as_double(there) or _both_nan(here, there)
            counts["equal" if same else "different"] += 1
            if not same:
                yield f"{_place(message, name)}: {data.hex()}: {here} here, {there} by cantools"


def _decoded(message: Any, data: bytes) -> dict[str, Any] | None:
    """By cantools; None where it cannot: a multiplexer value that is not in the database."""
    try:
        found: dict[str, Any] = message.decode(data, decode_choices=False, allow_excess=True)
    except Exception:  # whatever it raises: it does not decode
        return None
    return found


def _as_double(there: Any) -> Any:
    """A number of cantools as a double: it keeps whole numbers beyond what a double holds."""
    return float(there) if isinstance(there, int) else there


def _both_nan(here: float | None, there: Any) -> bool:
    numbers = isinstance(here, float) and isinstance(there, float)
    return numbers and math.isnan(here or 0.0) and math.isnan(there)


def _place(message: Message, name: str) -> str:
    said = "said" if name in message.left_out else "not said"
    return f"{message.name}.{name} (choice {said})"


if __name__ == "__main__":
    main()
